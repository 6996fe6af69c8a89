"""Names of targets and backgrounds: with planted defects, and with the options in which two of one name differ."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from advdiff_sumo.report.folder import Row


class Labels:
    """Labels of the targets and backgrounds of a run or sweep."""

    def __init__(self, rows: Iterable[Row]) -> None:
        self._variants: dict[tuple[str, str], set[str]] = {}
        for row in rows:
            for role in ("target", "background"):
                self._variants.setdefault((role, str(row[role])), set()).add(str(row[f"{role}_options"]))

    def target(self, row: Row) -> str:
        """Return the target's name, with its planted defects and those of its options that set it apart."""
        return self._label("target", row)

    def background(self, row: Row) -> str:
        """Return the background's name, with those of its options that set it apart."""
        return self._label("background", row)

    def _label(self, role: str, row: Row) -> str:
        name, own = str(row[role]), str(row[f"{role}_options"])
        options = _options(own)
        others = [_options(text) for text in self._variants.get((role, name), ())]
        telling = [
            key
            for key in sorted(options)
            if (key == "defects" and options[key]) or any(o.get(key) != options[key] for o in others)
        ]
        differences = ", ".join(
            _text(options[key]) if key == "defects" else f"{key} {_text(options[key])}" for key in telling
        )
        return f"{name} ({differences})" if differences else name


def _options(text: str) -> dict[str, Any]:
    try:
        options = json.loads(text)
    except ValueError:
        return {}
    return options if isinstance(options, dict) else {}


def _text(value: Any) -> str:
    return "+".join(map(_text, value)) if isinstance(value, list) else str(value)
