"""The tool that compares configurations of rivals: what it reads and what it counts."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

from advdiff_sumo.experiments.bench.cells import BenchCell
from advdiff_sumo.experiments.bench.episode_results import EpisodeResult, Gathered
from advdiff_sumo.experiments.bench.traces import UNTRACED
from advdiff_sumo.experiments.bench.write_table import markdown_text

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


def result(hit: bool, touched: int | None = 0, off_road: int | None = 0, cpu_s: float = 2.0) -> EpisodeResult:
    row = {"target_collision": hit, "bv_collisions": touched, "bv_offroad_vehicles": off_road}
    return EpisodeResult(f"{cpu_s:g}", row, UNTRACED, None, cpu_s)


def test_counts_by_hand(tool: ModuleType) -> None:
    """Two of four: Wilson's interval is 15 to 85 %."""
    results = [
        result(True),
        result(False, 2, cpu_s=4.0),
        result(True, None, None, 6.0),
        result(False, 1, 3, 8.0),
    ]
    table = tool.table_of(Gathered({BenchCell("strive:", "IDM", "strive"): results}), "a title")
    found = {key: cell.found for key, cell in table.lines[0].cells.items()}
    assert [found[key].value for key in ("collision_rate", "touched", "off_road", "cpu_s")] == [
        *(0.5, 0.75, 0.75, 5.0)
    ]
    assert found["collision_rate"].n == 4
    assert (found["collision_rate"].low, found["collision_rate"].high) == pytest.approx(
        (0.15, 0.85), abs=0.005
    )
    text = markdown_text(table)
    assert text.splitlines()[4].startswith("| IDM | strive: | ")


def test_nothing_finished(tool: ModuleType) -> None:
    table = tool.table_of(Gathered({BenchCell("strive:", "IDM", "strive"): []}), "a title")
    assert table.lines[0].cells["collision_rate"].found.value is None
