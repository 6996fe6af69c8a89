"""The result of ``bench defects`` as one object for other programs."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.experiments.bench.defect_cells import SOUND
from advdiff_sumo.experiments.bench.defect_score import COUNTS, DETECTIONS, RULE_COLUMNS
from advdiff_sumo.experiments.bench.table import Table


def defects_object(path: Path, table: Table) -> dict[str, Any]:
    """Return the result of the bench in *path*, whose table is *table*.

    Returns:
        ``folder``; ``detected`` and ``planted``, counts over all backgrounds and targets; ``defects``, an object each
        with ``background``, ``target``, ``defect``, ``detected``, ``p``, ``p_holm``, and counts of seed scenes:
        ``scenes`` (finished by both), ``failures``, ``sound_failures``, ``only_defect``, ``only_sound``; by broken
        rules ``broke_rule`` and ``sound_broke_rule``, counts of scenes, ``rules_p_holm``, ``detected_by_rules`` (not in
        folders of earlier versions); ``sound``, valid failures of sound targets by background; ``notes``.

    Raises:
        FileError: the table of detections is missing or damaged.
    """
    file = path / DETECTIONS
    try:
        with file.open(encoding="utf-8", newline="") as lines:
            defects = [_defect(row) for row in csv.DictReader(lines)]
    except (OSError, KeyError, ValueError) as error:
        raise FileError(file, f"cannot be read ({error})", "choose a new --out") from None
    return {
        "folder": str(path),
        "detected": sum(defect["detected"] for defect in defects),
        "planted": len(defects),
        "defects": defects,
        "sound": _sound(table),
        "notes": list(table.notes),
    }


def _defect(row: Mapping[str, str]) -> dict[str, Any]:
    return {
        **{name: row[name] for name in ("background", "target", "defect")},
        "detected": _flag(row["detected"]),
        **{name: float(row[name]) for name in ("p", "p_holm")},
        **{name: int(row[name]) for name in COUNTS},
        **_by_rules(row),
    }


def _by_rules(row: Mapping[str, str]) -> dict[str, Any]:
    if RULE_COLUMNS[-1] not in row:  # of an earlier version
        return {}
    readers: tuple[Callable[[str], object], ...] = (int, int, float, _flag)
    return {name: read(row[name]) for name, read in zip(RULE_COLUMNS, readers, strict=True)}


def _flag(text: str) -> bool:
    return text == "true"


def _sound(table: Table) -> list[dict[str, Any]]:
    return [
        {
            "background": background,
            "target": line.group,
            "scenes": cell.found.n,
            "failures": round((cell.found.value or 0.0) * (cell.found.n or 0)),
        }
        for line in table.lines
        if line.key == SOUND
        for background, cell in line.cells.items()
    ]
