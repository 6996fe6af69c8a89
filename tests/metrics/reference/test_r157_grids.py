"""The reference drivers against the outcomes of the regulation's own tool."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.metrics.reference.driver_models import FSM, HUMAN, REGULATION, RSS

TOOL = Path(__file__).resolve().parents[3] / "tools" / "check_reference_drivers.py"
sys.path.insert(0, str(TOOL.parent))

from reference_src.r157_scenarios import car_following, cut_in, cut_out  # noqa: E402 - the tools are no package


def check(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(TOOL), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def array(*values: float) -> np.ndarray:
    return np.array(values, dtype=np.float64)


def test_a_cut_in_right_before_the_bumper_hits_all_models_and_a_far_one_none() -> None:
    ego, other = array(60 / 3.6, 60 / 3.6), array(10 / 3.6, 10 / 3.6)
    gap, lateral = array(25.0, 59.0), array(1.5, 1.5)
    # 16 m less the 8.6 m of both boxes: over in 1.1 s, at 13.9 m/s closing
    assert [bool(cut_in(m, ego, other, gap, lateral)[0]) for m in (HUMAN, REGULATION)] == [True, True]
    assert not any(cut_in(m, ego, other, gap, lateral)[1] for m in (HUMAN, REGULATION, RSS, FSM))


def test_no_cut_in_at_lateral_speed_zero() -> None:
    for model in (HUMAN, REGULATION, RSS, FSM):
        assert not cut_in(model, array(60 / 3.6), array(10 / 3.6), array(1.0), array(0.0)).any()


def test_a_standing_vehicle_close_behind_a_cut_out_is_hit() -> None:
    speed, lateral = array(120 / 3.6, 120 / 3.6), array(-0.3, -2.9)
    assert cut_out(HUMAN, speed, array(30.0, 140.0), lateral).tolist() == [True, False]


def test_a_leader_that_brakes_harder_than_rss_allows_is_hit_with_the_speed_that_is_left() -> None:
    crash, impact = car_following(RSS, array(128 / 3.6, 30 / 3.6), array(0.95, 0.3))
    assert crash.tolist() == [True, False]
    assert 0.0 < impact[0] < 10.0
    assert impact[1] == 0.0


@pytest.mark.data
@pytest.mark.parametrize("grid", ["cut_in_low", "cut_out", "car_following"])
def test_the_grids_of_the_regulations_tool(adv_data: Path, grid: str) -> None:
    result = check(adv_data / "r157" / f"{grid}.csv.gz")
    assert result.returncode == 0, result.stdout + result.stderr
    kind = {"cut_in_low": "cut-in", "cut_out": "cut-out", "car_following": "car following"}[grid]
    assert result.stdout.startswith(f"{grid}.csv.gz: {kind}\n")


def test_disagreement_with_a_grid_exits_with_1(tmp_path: Path) -> None:
    grid = tmp_path / "wrong.csv"
    grid.write_text("ego_kmh,other_kmh,gap_m,lateral_mps,RSS\n60,10,59,0.5,1\n60,10,59,0.0,0\n")
    result = check(grid, "--differences")
    assert result.returncode == 1
    assert "theirs collides: ego_kmh 60, other_kmh 10, gap_m 59, lateral_mps 0.5" in result.stdout


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a,b\n1,2\n", "its columns (a, b) are those of no grid"),
        ("", "holds no cells"),
        ("model,speed_kmh,decel_g,crash\nIDM,10,0.1,0\n", "no model 'IDM'; known are CC_human_driver"),
        ("model,speed_kmh,decel_g,crash\nRSS,ten,0.1,0\n", "every cell must be a number"),
        ("model,speed_kmh,decel_g,crash\nRSS,10\n", "line 2 has another number of columns"),
    ],
)
def test_an_invalid_grid_is_reported_in_one_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    grid = tmp_path / "grid.csv"
    grid.write_text(text)
    result = check(grid)
    assert result.returncode == 2
    assert sentence in result.stderr
    assert "Traceback" not in result.stderr
    assert check(tmp_path / "missing.csv").returncode == 2
