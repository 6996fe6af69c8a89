"""Write the fidelity figures of a conversion (NAME.fidelity.json) and a page with overlay pictures (.html)."""

from __future__ import annotations

import base64
import io
import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.convert import ConversionResult
from advdiff_sumo.maps.convert.written_net import WrittenNet, read_net

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ location }}: fidelity of the net</title>
<style>
 body{font:15px/1.5 system-ui,sans-serif;max-width:64rem;margin:1.5rem auto;padding:0 1rem;color:#1b2024}
 h1{font-size:1.6rem;line-height:1.25} h2{font-size:1.15rem;margin:1.75rem 0 .25rem}
 table{border-collapse:collapse;width:100%;margin:.25rem 0 1rem}
 td,th{border-bottom:1px solid #d5dade;padding:.25rem .6rem .25rem 0;text-align:left;vertical-align:top}
 table.figures td:first-child{width:38%;color:#4a545c}
 td.v{font-variant-numeric:tabular-nums;overflow-wrap:anywhere}
 .yes{color:#17692f}.no{color:#b3261e;font-weight:600}
 figure{margin:0 0 1rem} img{max-width:100%;display:block} figcaption{color:#4a545c}
 .key{display:inline-block;width:1.6em;margin-right:.3em;vertical-align:middle}
</style></head><body>
<h1>{{ location }}: how well the SUMO net holds the HD map</h1>
<p>Source: {{ source }}. Lengths in metres.
Errors are measured on the net as netconvert wrote it, every half metre, in both
directions.</p>
{% if verdicts %}
<table><tr><th>Measure</th><th>Found</th><th>Bar</th><th>Met</th></tr>
{% for name, found, bar, met in verdicts %}
<tr><td>{{ name }}</td><td class="v">{{ found }}</td><td class="v">{{ bar }}</td>
<td class="{{ "yes" if met else "no" }}">{{ "yes" if met else "no" }}</td></tr>
{% endfor %}</table>
{% endif %}
<h2>Overlay</h2>
<p>{% for colour, thickness, meaning in legend %}<span class="key" style="border-top:{{ thickness }}px solid
{{ colour }}"></span>{{ meaning }}{{ ". " if loop.last else "; " }}{% endfor %}
Where the net is exact, each thin line runs in the middle of a wide one.</p>
{% for picture, caption in pictures %}
<figure><img alt="{{ caption }}" src="data:image/png;base64,{{ picture }}">
<figcaption>{{ caption }}</figcaption></figure>
{% endfor %}
{% for topic, rows in topics %}
<h2>{{ topic }}</h2>
<table class="figures">{% for name, value in rows %}<tr><td>{{ name }}</td><td class="v">{{ value }}</td></tr>
{% endfor %}</table>
{% endfor %}
</body></html>
"""
AREA, SOURCE, LANE, WAY = "#e6e6e6", "#f5a623", "#0b5fa5", "#1a8f3c"
LEGEND = (
    (AREA, 8, "drivable area of the map"),
    (SOURCE, 6, "centre lines of the map"),
    (LANE, 2, "lanes of the net"),
    (WAY, 2, "ways through junctions"),
)
PICTURE_IN = 10.0  # longer side of a picture in inches
DETAIL_M = 60.0  # half the side of the square that the detail shows
DRIVEN = {
    "driving_test_in_the_hour": "set out within the hour",
    "driving_test_at_once": "on the road at any time",
}
INCIDENTS = {
    "teleports": "teleports",
    "collisions_sumo": "collisions, SUMO's list",
    "collisions_boxes": "collisions, overlapping boxes",
}
LONGEST_LIST = 12  # items of a list that the page shows
PAIR = 2  # lists of at most this many items are written "a → b"
MEDIAN_BAR_M = 0.02  # largest accepted median error of centre lines
LARGEST_BAR_M = 0.20  # largest accepted error of a centre line
DASHED_BAR = 0.95  # smallest accepted share of dashed pairs in one edge


def fidelity_path(net: Path, suffix: str = "json") -> Path:
    """Return the path of the figures of a net: NAME.net.xml → NAME.fidelity.json (or .html)."""
    return net.with_name(net.name.removesuffix(".xml").removesuffix(".net") + f".fidelity.{suffix}")


def write_figures(figures: Mapping[str, Any], path: Path) -> None:
    """Write *figures* as JSON."""
    path.write_text(json.dumps(figures, indent=1, sort_keys=False) + "\n", encoding="utf-8")


def write_page(result: ConversionResult, figures: Mapping[str, Any], path: Path) -> None:
    """Write the page about a conversion: requirements, overlay pictures and every figure."""
    template = jinja2.Environment(autoescape=True, trim_blocks=True).from_string(PAGE)
    topics = [
        (topic.replace("_", " ").capitalize(), _rows(value) or [("", "none")])
        for topic, value in figures.items()
        if topic not in ("location", "source")
    ]
    page = template.render(
        location=result.source.location,
        source=result.source.path.name,
        verdicts=verdicts(figures),
        legend=LEGEND,
        pictures=_pictures(result),
        topics=topics,
    )
    path.write_text(page + "\n", encoding="utf-8")


def verdicts(figures: Mapping[str, Any]) -> list[tuple[str, str, str, bool]]:
    """Return (measure, value found, required value, whether met) of each requirement that was measured."""
    rows = []
    for key, name in (("source_to_net", "map to net"), ("net_to_source", "net to map")):
        error = figures["centre_line_error_m"][key]
        error_text = f"{error['median']:.4f}, {error['max']:.4f}"
        bar = f"{MEDIAN_BAR_M:.2f}, {LARGEST_BAR_M:.2f}"
        met = error["median"] <= MEDIAN_BAR_M and error["max"] <= LARGEST_BAR_M
        rows.append((f"Centre lines, {name}: median, largest", error_text, bar, met))
    rows += [_zero_row(measure, count) for measure, count in _fault_counts(figures)]
    share = figures["lane_changes"]["share"]
    if share is not None:
        met = share >= DASHED_BAR
        rows.append(("Dashed pairs that share an edge", f"{share:.1%}", f"{DASHED_BAR:.0%}", met))
    poses = figures.get("logged_poses", {})
    if poses.get("poses"):
        on, total = poses["on_a_lane_of_the_net"], poses["poses"]
        rows.append(("Logged poses on a lane", f"{on} of {total}", "all", on == total))
        rows.append(_zero_row("Poses whose offset differs by over 0.05", poses["differences_above_0.05_m"]))
    return rows + [
        row for key, name in DRIVEN.items() if key in figures for row in _driving_rows(figures[key], name)
    ]


def _driving_rows(test: Mapping[str, Any], name: str) -> list[tuple[str, str, str, bool]]:
    """Return the requirements of one driving test."""
    title = f"{test['vehicles']} vehicles {name}"
    rows = [_zero_row(f"{title}: {measure}", test[key]) for key, measure in INCIDENTS.items()]
    rate = test["emergency_brakings_per_1000_km"]
    if rate is not None:
        measure = f"{title}: emergency brakings per 1,000 vehicle-km"
        rows.append((measure, f"{rate:.2f}", "below 1", rate < 1.0))
    return rows


def _zero_row(measure: str, count: int) -> tuple[str, str, str, bool]:
    """Return the row of a requirement that *count* is zero."""
    return measure, str(count), "0", count == 0


def _fault_counts(figures: Mapping[str, Any]) -> list[tuple[str, int]]:
    """Return the faults that must not occur, each with its count."""
    unexplained = sum(row["meaning"] == "not explained" for row in figures["netconvert_warnings"])
    return [
        ("Lanes and connectors of the file left out", len(figures["lanes"]["left_out"])),
        ("Traffic lights that stop nobody", len(figures["signals"]["that_stop_nobody"])),
        ("Lanes and connectors lost", len(figures["lanes"]["lost"])),
        ("Links lost", len(figures["connections"]["lost"])),
        ("Links invented", len(figures["connections"]["invented"])),
        ("Routes over edges that no lane follows", len(figures["routes_no_lane_follows"])),
        ("Kinds of netconvert warnings not explained", unexplained),
    ]


def _rows(value: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Return nested values as (name, text) rows; long lists are shortened (the JSON file holds them whole)."""
    if isinstance(value, Mapping):
        return [
            row for key, inner in value.items() for row in _rows(inner, f"{prefix}{key} ".replace("_", " "))
        ]
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        return [row for number, inner in enumerate(value) for row in _rows(inner, f"{prefix}{number + 1} ")]
    if isinstance(value, list):
        items = ", ".join(_item(item) for item in value[:LONGEST_LIST])
        more = f" … ({len(value)} in all)" if len(value) > LONGEST_LIST else ""
        return [(prefix.strip(), (items + more) or "none")]
    return [(prefix.strip(), "not measured" if value is None else str(value))]


def _item(item: Any) -> str:
    """Return a pair as "a → b", a longer list by its size and first members."""
    if not isinstance(item, list):
        return str(item)
    if len(item) <= PAIR:
        return " → ".join(map(str, item))
    return f"[{len(item)}: {' '.join(map(str, item[:6]))}{' …' if len(item) > 6 else ''}]"


def _pictures(result: ConversionResult) -> list[tuple[str, str]]:
    """Return (base64 PNG, caption) of the whole map and of the junction with most connections."""
    net = read_net(result.net)
    lines = [line for line, _ in (*net.lanes.values(), *net.connections.values())]
    points = np.vstack(lines)
    whole = np.array([points.min(axis=0) - 10.0, points.max(axis=0) + 10.0])
    pictures = [(_picture(result, net, whole, 1.0), "Centre lines of the map under lanes of the net")]
    connection_counts = Counter(
        next(e.target for e in result.plan.edges if e.id == c.origin[0]) for c in result.plan.connections
    )
    if connection_counts:
        name, count = min(connection_counts.items(), key=lambda item: (-item[1], item[0]))
        middle = np.array(next(j.xy_m for j in result.plan.junctions if j.id == name))
        detail = np.array([middle - DETAIL_M, middle + DETAIL_M])
        caption = f"Detail: junction {name}, the one with most ways ({count})"
        pictures.append((_picture(result, net, detail, 3.0), caption))
    return pictures


def _picture(result: ConversionResult, net: WrittenNet, extent: FloatArray, scale: float) -> str:
    """Return the overlay of map and net as base64 PNG.

    Args:
        result: the conversion.
        net: its net.
        extent: (2, 2) lower left and upper right corner in m.
        scale: factor on the thickness of lines.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # late, with what follows: slow to import
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as MplPath

    width, height = extent[1] - extent[0]
    inches = PICTURE_IN * np.array([width, height]) / max(width, height)
    figure = Figure(figsize=tuple(np.maximum(inches, 2.0)), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for part in result.source.drivable.geoms:
        rings = [part.exterior, *part.interiors]
        outline = MplPath.make_compound_path(*[MplPath(np.asarray(ring.coords)[:, :2]) for ring in rings])
        axes.add_patch(PathPatch(outline, facecolor=AREA, edgecolor="none"))
    layers = (
        ([lane.centre_m for lane in result.source.lanes], SOURCE, 2.2 * scale),
        ([line for line, _ in net.lanes.values()], LANE, 0.5 * scale),
        ([line for line, _ in net.connections.values()], WAY, 0.4 * scale),
    )
    for lines, colour, thickness in layers:
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=thickness))
    axes.set(xlim=extent[:, 0], ylim=extent[:, 1], aspect="equal", xlabel="east in m", ylabel="north in m")
    axes.tick_params(labelsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return base64.b64encode(buffer.getvalue()).decode("ascii")
