"""The third-party planner of ``examples`` drives, if its package is installed."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip(
    "commonroad_idm_planner", reason="pip install commonroad-idm-planner, in an environment without Ray"
)

from advdiff_sumo.experiments.target_trial import Extent, check_target


def test_it_keeps_the_contract_and_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2]))
    extent = Extent(episodes=1, horizon_s=6.0, within_ms=60_000.0)
    verdicts = check_target("examples.commonroad_idm:CommonRoadIdm", {"headway_s": 1.5}, extent)
    assert [x for x in verdicts if not x.ok] == []
