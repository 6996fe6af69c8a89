"""Results of a sweep can be read without its planners, and none of them is started."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import ConfigError, UnknownNameError
from advdiff_sumo.experiments.folder_rows import rows_of_folder
from advdiff_sumo.experiments.judge_folder import open_judging
from advdiff_sumo.sweep.job_plan import plan_sweep
from advdiff_sumo.sweep.rounds import stored_plan
from advdiff_sumo.sweep.spec import SweepSpec
from advdiff_sumo.sweep.sweep_runner import open_store
from tests.sweep.conftest import planned, serially, values


def test_a_sweep_whose_planner_cannot_be_imported(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = serially(planned(place), tmp_path / "s")
    monkeypatch.delitem(sys.modules, "sick_planners")
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry != str(place)])
    assert [row["target"] for row in rows_of_folder(store.path).episodes] == ["sick_planners:Coasts"] * 2
    assert (
        open_judging(store.path).doubt == ""
    )  # verdicts are also stored in the episodes, not only in the tables
    with pytest.raises(ConfigError, match="'sick_planners:Coasts' cannot be imported"):
        stored_plan(store, drives=True)


def spec_of(place: Path, target: str, background: str) -> SweepSpec:
    """Return a sweep of two episodes."""
    grid = {"nets": [str(place / "small.net.xml")], "targets": [target], "backgrounds": [background]}
    return SweepSpec.of(values(place, grid=grid), "test")


def test_a_planner_in_a_separate_process_is_not_started(place: Path, tmp_path: Path) -> None:
    started = tmp_path / "started"
    spec = spec_of(place, f"exec:touch {started}", "replay")
    open_store(tmp_path / "s", plan_sweep(spec, drives=False), 1, resume=False)
    assert rows_of_folder(tmp_path / "s").missing == 2
    assert not started.exists()
    with pytest.raises(ConfigError):
        plan_sweep(spec)
    assert started.exists()


@pytest.mark.parametrize(("target", "background"), [("once_installed", "replay"), ("IDM", "nowhere:Policy")])
def test_a_plug_in_that_is_no_longer_installed(
    place: Path, tmp_path: Path, target: str, background: str
) -> None:
    spec = spec_of(place, target, background)
    open_store(tmp_path / "s", plan_sweep(spec, drives=False), 1, resume=False)
    assert rows_of_folder(tmp_path / "s").missing == 2
    with pytest.raises((ConfigError, UnknownNameError)):
        plan_sweep(spec)
