"""The tool that compares configurations of rivals: what it reads and what it counts."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "tune_rivals.py"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("tune_rivals", TOOL)
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = made  # dataclasses look there
    spec.loader.exec_module(made)
    return made


def test_configurations(tool: ModuleType) -> None:
    assert tool.options_of("strive:") == ("strive", {})
    assert tool.options_of("advsim") == ("advsim", {})
    found = tool.options_of("advsim:candidates=64,spread=0.8,initial=model")
    assert found == ("advsim", {"candidates": 64, "spread": 0.8, "initial": "model"})


def row(hit: bool, touched: int | None = 0, off_road: int | None = 0) -> dict[str, Any]:
    return {"target_collision": hit, "bv_collisions": touched, "bv_offroad_vehicles": off_road}


def test_counts_by_hand(tool: ModuleType, tmp_path: Path) -> None:
    """Two of four: Wilson's interval is 15 to 85 %."""
    rows = [(row(True), 2.0), (row(False, 2), 4.0), (row(True, None, None), 6.0), (row(False, 1, 3), 8.0)]
    result = tool.Result.of(rows)
    assert (result.episodes, result.hits, result.touched, result.off_road) == (4, 2, 3, 3)
    assert result.cells() == ("2 of 4", "15–85 %", "3", "3", "5.0")
    tool.write({("strive:", "IDM"): result}, tmp_path / "table.md")
    assert (
        (tmp_path / "table.md")
        .read_text(encoding="utf-8")
        .splitlines()[2]
        .startswith("| `strive:` | IDM | 2 of 4 ")
    )


def test_nothing_finished(tool: ModuleType) -> None:
    assert tool.Result.of([]).cells()[0] == "0 of 0"
