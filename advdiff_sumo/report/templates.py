"""Loads the page's templates, styles and scripts, and formats the numbers and words in them."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from advdiff_sumo.core.wording import counted
from advdiff_sumo.metrics.near_miss import resolution_clause
from advdiff_sumo.metrics.severity import badge

ASSETS = Path(__file__).parent / "assets"
_SCRIPTS = ("decode.js", "scene.js", "charts.js", "player.js", "table.js", "main.js")
_DASH = "–"
_NO_BREAK = "\u00a0"
_TIME_OF_OFFENCE = re.compile(r" \(\d+\.\d s\)(?:, |\.$)")


@cache
def templates() -> Environment:
    """Return the environment of the templates, with filters for numbers and words; a template is compiled once."""
    environment = Environment(
        loader=FileSystemLoader(ASSETS),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "counted": counted,
        "number": number,
        "percent": percent,
        "words": words,
        "yes_no": yes_no,
        "title": title,
        "badge": badge,
        "near_miss": near_miss_sentence,
        "breaches_of": breaches_of,
        "further_offences": further_offences,
        "as_json": as_json,
    }
    environment.globals |= {"asset": _asset, "scripts": _scripts}
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
    """Return a table's word for display (``rear_end_struck`` → "rear end struck"); a dash for None."""
    return name.replace("_", " ") if name else _DASH


def breaches_of(row: Mapping[str, Any]) -> list[str]:
    """Return the broken rules that led to an episode's collision, and all others that the target broke."""
    listed = ", ".join(row[name] or "" for name in ("target_breaches", "other_breaches", "offences"))
    return sorted({word for word in listed.split(", ") if word})


def near_miss_sentence(row: Mapping[str, Any]) -> str:
    """Return who and when a critical near miss was with (not of earlier versions), its braking, and who resolved it."""
    partner, time_s = row.get("near_miss_partner"), row.get("near_miss_time_s")
    who = f"Near miss with '{partner}' at {number(time_s, 1, 's')}: a" if partner else "A"
    brake = number(row["critical_brake_mps2"], 1, "m/s²")
    return (
        f"{who} careful driver would have had to brake at {brake}; {resolution_clause(row['resolved_by'])}."
    )


def further_offences(row: Mapping[str, Any]) -> str:
    """Return the sentence on rules that the target broke; "" if the verdict names all of them already."""
    sentence, verdict = str(row["offences_text"] or ""), str(row["verdict"] or "")
    offences = _TIME_OF_OFFENCE.sub("\n", sentence.removeprefix("The target ")).split("\n")
    return "" if all(offence in verdict for offence in offences) else sentence


def yes_no(flag: bool | None) -> str:
    """Return "yes" or "no"; a dash for None."""
    return _DASH if flag is None else ("yes" if flag else "no")


def title(row: Mapping[str, Any]) -> str:
    """Return the outcome of an episode, a row of ``episodes.parquet``, in a few words."""
    if row["target_collision"]:
        return f"{words(row['collision_type'])} at {number(row['collision_time_s'], 1, 's')}"
    if row["end"] == "failed":
        return f"failed ({words(row['failure_kind'])})"
    if row["min_ttc_s"] is not None:
        return f"no collision, least time to collision {number(row['min_ttc_s'], 2, 's')}"
    return "no collision"


def as_json(value: Any) -> Markup:
    """Return *value* as JSON that is safe in a script element."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))  # noqa: S704 - no tag can begin in it


def _asset(name: str) -> Markup:
    return Markup((ASSETS / name).read_text(encoding="utf-8").strip())  # noqa: S704 - our own file


def _scripts() -> Markup:
    parts = (ASSETS.joinpath(name).read_text(encoding="utf-8") for name in _SCRIPTS)
    return Markup('"use strict";\n{\n' + "\n".join(parts) + "}")  # noqa: S704 - our own files
