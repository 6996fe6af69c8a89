"""NAME.fidelity.json and the page NAME.fidelity.html with the overlay picture."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.convert import ConversionResult
from advdiff_sumo.maps.convert.netread import read_net

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{{ location }}: fidelity of the net</title>
<style>
 body{font:15px/1.5 system-ui,sans-serif;max-width:64rem;margin:2rem auto;padding:0 1rem;color:#222}
 table{border-collapse:collapse;width:100%;margin:.5rem 0 1.5rem}
 td,th{border-bottom:1px solid #ddd;padding:.25rem .6rem;text-align:left;vertical-align:top}
 td.v{font-variant-numeric:tabular-nums} img{max-width:100%} h2{margin-top:2rem}
</style></head><body>
<h1>{{ location }}: how well the SUMO net holds the HD map</h1>
<p>Lengths in metres. Errors are measured on the net as netconvert wrote it, every half metre, in both directions.</p>
<h2>Overlay</h2>
<p>Grey: drivable area of the map. Orange, wide: centre lines of the map. Blue, thin: lanes of the net; green: ways
through junctions. Where the net is exact, each thin line runs in the middle of a wide one.</p>
<img alt="Centre lines of the map under lanes of the net" src="data:image/png;base64,{{ picture }}">
{% for topic, rows in topics %}
<h2>{{ topic }}</h2>
<table>{% for name, value in rows %}<tr><td>{{ name }}</td><td class="v">{{ value }}</td></tr>{% endfor %}</table>
{% endfor %}
</body></html>
"""
LONGEST_LIST = 12


def fidelity_path(net: Path, suffix: str = "json") -> Path:
    """Return the path of the figures beside a net: NAME.net.xml → NAME.fidelity.json (or .html)."""
    return net.with_name(net.name.removesuffix(".xml").removesuffix(".net") + f".fidelity.{suffix}")


def write_figures(figures: Mapping[str, Any], path: Path) -> None:
    """Write *figures* as JSON."""
    path.write_text(json.dumps(figures, indent=1, sort_keys=False) + "\n", encoding="utf-8")


def write_page(result: ConversionResult, figures: Mapping[str, Any], path: Path) -> None:
    """Write the page about a conversion: the overlay picture and every figure."""
    template = jinja2.Environment(autoescape=True).from_string(PAGE)
    topics = [
        (topic.replace("_", " "), _rows(value)) for topic, value in figures.items() if topic != "location"
    ]
    page = template.render(location=result.source.location, picture=_picture(result), topics=topics)
    path.write_text(page + "\n", encoding="utf-8")


def _rows(value: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Return nested values as (name, text) rows; long lists are cut, the JSON file has them whole."""
    if isinstance(value, Mapping):
        return [
            row for key, inner in value.items() for row in _rows(inner, f"{prefix}{key} ".replace("_", " "))
        ]
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        return [row for number, inner in enumerate(value) for row in _rows(inner, f"{prefix}{number + 1} ")]
    if isinstance(value, list):
        shown = ", ".join(
            " → ".join(map(str, v[:6])) if isinstance(v, list) else str(v) for v in value[:LONGEST_LIST]
        )
        more = f" … ({len(value)} in all)" if len(value) > LONGEST_LIST else ""
        return [(prefix.strip(), (shown + more) or "none")]
    return [(prefix.strip(), "not measured" if value is None else str(value))]


def _picture(result: ConversionResult) -> str:
    """Return the overlay as base64 PNG."""
    net = read_net(result.net)
    figure = Figure(figsize=(12, 12), dpi=150)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.03, 0.03, 0.96, 0.96))
    areas: list[FloatArray] = [np.asarray(part.exterior.coords) for part in result.source.drivable.geoms]
    axes.add_collection(PolyCollection(areas, facecolors="#eeeeee", edgecolors="none"))
    layers = (
        ([lane.centre_m for lane in result.source.lanes], "#f5a623", 2.2),
        ([line for line, _ in net.lanes.values()], "#0b5fa5", 0.5),
        ([line for line, _ in net.ways.values()], "#1a8f3c", 0.4),
    )
    for lines, colour, width in layers:
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=width))
    axes.autoscale()
    axes.set_aspect("equal")
    axes.tick_params(labelsize=6)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return base64.b64encode(buffer.getvalue()).decode("ascii")
