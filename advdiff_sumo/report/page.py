"""Writes ``report.html``: one file, no network, the same bytes for the same run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import FileError
from advdiff_sumo.report.charts import charts_of
from advdiff_sumo.report.folder import FinishedRun, Row
from advdiff_sumo.report.layer import MapLayer
from advdiff_sumo.report.overview import overview_of
from advdiff_sumo.report.picture import picture_of
from advdiff_sumo.report.rates import headline
from advdiff_sumo.report.select import pictured, worst_first
from advdiff_sumo.report.series import series_of
from advdiff_sumo.report.svg import svg_picture

#: Pictures beyond this many bytes are left out, the least severe episodes first.
PICTURE_BYTES = 8_000_000
_DASH = "–"
_NO_BREAK = "\u00a0"


@dataclass(frozen=True)
class Section:
    """One episode's part of the page: its number, its HTML, and where the target drove (T, 2)."""

    episode: int
    html: str
    target_xy_m: FloatArray


def write_report(folder: Path) -> Path:
    """Write ``report.html`` into the folder of a finished or interrupted run and return its path.

    Raises:
        FileError: a file of the run is missing or damaged, or the report cannot be written.
    """
    path = folder / "report.html"
    content = report_html(FinishedRun.read(folder)).encode()
    aside = path.with_suffix(".aside")
    try:
        aside.write_bytes(content)
        aside.replace(path)
    except OSError as error:
        raise FileError(path, f"cannot be written ({error.strerror})", "make the folder writable") from None
    return path


def report_html(run: FinishedRun) -> str:
    """Return the page of *run*."""
    templates = _templates()
    layer = None if run.road is None else MapLayer(run.road)
    ordered = worst_first(run.episodes)
    wanted = pictured(ordered)
    sections = list(_within_budget(_sections(run, layer, wanted, templates)))
    shown = {section.episode for section in sections}
    return templates.get_template("page.html").render(
        run=run,
        name=run.folder.resolve().name,
        planned=run.options.get("episodes"),
        settings=list(_flat(run.settings)),
        rates=headline(run.episodes),
        overview=overview_of(layer, [s.target_xy_m for s in sections], run.episodes),
        episodes=ordered,
        shown=shown,
        left_out=len(wanted) - len(sections),
        sections=[s.html for s in sections],
    )


def _sections(
    run: FinishedRun, layer: MapLayer | None, rows: list[Row], templates: Environment
) -> Iterator[Section]:
    template = templates.get_template("episode.html")
    for row in rows:
        number = int(row["episode"])
        states, contacts = run.states(number), run.collisions_of(number)
        if states is None:
            yield Section(number, template.render(row=row, picture=None, contacts=contacts), np.zeros((0, 2)))
            continue
        picture = picture_of(states, row, contacts, layer)
        html = template.render(
            row=row,
            picture=picture,
            svg=svg_picture(picture),
            charts=charts_of(series_of(states, picture.attacker), row["collision_time_s"]),
            contacts=contacts,
            target_id=states.tracks.ids[states.target],
        )
        yield Section(number, html, states.tracks.xy_m[states.target])


def _within_budget(sections: Iterator[Section]) -> Iterator[Section]:
    """Yield sections until ``PICTURE_BYTES`` are used up; the first one always."""
    used = 0
    for section in sections:
        used += len(section.html.encode())
        if used > PICTURE_BYTES and used > len(section.html.encode()):
            return
        yield section


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield (dotted name, value as text) of nested tables."""
    for key, value in settings.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        else:
            yield name, str(value).lower() if isinstance(value, bool) else str(value)


def _templates() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "percent": percent, "words": words, "yes_no": yes_no}
    return environment


def number(value: float | None, digits: int = 1, unit: str = "") -> str:
    """Return *value* with a typographic minus and its unit; a dash for None and NaN."""
    if value is None or not np.isfinite(value):
        return _DASH
    text = f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "−")  # + 0.0: no minus before a zero
    return f"{text}{_NO_BREAK}{unit}" if unit else text


def percent(share: float | None, digits: int = 1) -> str:
    """Return a share as a percentage; a dash for None."""
    return _DASH if share is None else f"{100.0 * share:.{digits}f}{_NO_BREAK}%"


def words(name: str | None) -> str:
    """Return a table's word as one reads it (``rear_end_struck`` → "rear end struck"); a dash for None."""
    return name.replace("_", " ") if name else _DASH


def yes_no(flag: bool | None) -> str:
    """Return "yes" or "no"; a dash for None."""
    return _DASH if flag is None else ("yes" if flag else "no")
