"""Labels of runs, targets and backgrounds: names, planted defects, and options that distinguish equal names."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from advdiff_sumo.report.folder import FinishedRun, Row

#: Backgrounds that attack, each with the option values that turn its attacks off.
_ATTACKING: Mapping[str, Mapping[str, Any]] = {
    "scripted": {},
    "diffusion": {"guide": "none", "strength": 0},
    "strive": {"rounds": 0},
    "advsim": {"rounds": 0},
    "adv-rl": {"strength": 0},
}
_NATURAL = {"sumo": "SUMO", "replay": "replayed", "traj2traj": "traj2traj"}


class Labels:
    """Labels of the targets and backgrounds of a run or sweep."""

    def __init__(self, rows: Iterable[Row]) -> None:
        self._variants: dict[tuple[str, str], set[str]] = {}
        for row in rows:
            for role in ("target", "background"):
                self._variants.setdefault((role, str(row[role])), set()).add(str(row[f"{role}_options"]))

    def target(self, row: Row) -> str:
        """Return the target's name, with its planted defects and the options that distinguish it."""
        return self._label("target", row)

    def background(self, row: Row) -> str:
        """Return the background's name, with the options that distinguish it."""
        return self._label("background", row)

    def _label(self, role: str, row: Row) -> str:
        name, own_text = str(row[role]), str(row[f"{role}_options"])
        options = _options(own_text)
        all_options = [_options(text) for text in self._variants.get((role, name), ())]
        shown_keys = [
            key
            for key in sorted(options)
            if (key == "defects" and options[key])
            or any(other.get(key) != options[key] for other in all_options)
        ]
        differences = ", ".join(
            _text(options[key]) if key == "defects" else f"{key} {_text(options[key])}" for key in shown_keys
        )
        return f"{name} ({differences})" if differences else name


def run_title(labels: Labels, run: FinishedRun) -> str:
    """Return the title of a run: its target "against" an attacking background, or "in" traffic without attackers."""
    targets = sorted({labels.target(row) for row in run.episodes})
    target = targets[0] if targets else run.options.get("target", "target")
    background = str(run.options.get("background", "background"))
    non_attacking = _ATTACKING.get(background)
    background_options = run.options.get("background_options", {})
    if non_attacking is None:
        return f"{target} in {_NATURAL.get(background, background)} traffic"
    if any(background_options.get(name) == value for name, value in non_attacking.items()):
        return f"{target} in unguided {background} traffic"
    return f"{target} against {background} traffic"


def _options(text: str) -> dict[str, Any]:
    try:
        options = json.loads(text)
    except ValueError:
        return {}
    return options if isinstance(options, dict) else {}


def _text(value: Any) -> str:
    return "+".join(map(_text, value)) if isinstance(value, list) else str(value)
