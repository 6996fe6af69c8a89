"""``advdiff-sumo check-policy`` as a user types it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.e2e.commands import TINY, Outcome, advdiff

POLICIES = """
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.plan import JointPlan


class Everybody:
    "Lets everybody go on as now, the target and those that it may not move, too."

    def __init__(self, seconds=1.0):
        self.steps = round(seconds / 0.1)

    def start(self, road, scene, log, rng):
        return None

    def plan(self, road, scene, memory, rng):
        now = scene.history.window(scene.history.steps - 1, scene.history.steps)
        same = np.ones((now.agents, self.steps))
        ahead = np.stack((np.cos(now.yaw_rad), np.sin(now.yaw_rad)), -1) * now.speed_mps[..., None]
        tracks = replace(
            now,
            xy_m=now.xy_m + ahead * 0.1 * np.arange(1, self.steps + 1)[:, None],
            yaw_rad=now.yaw_rad * same,
            speed_mps=now.speed_mps * same,
            valid=same > 0.0,
            t0_s=scene.time_s + 0.1,
            dt_s=0.1,
        )
        return JointPlan(tracks), None


class Nothing:
    pass
"""
QUICK = ("--net", "grid.net.xml", "--episodes", 1, *TINY)


@pytest.fixture
def folder(workplace: Path) -> Path:
    """Return a folder with a net and a user's policies."""
    (workplace / "our_policies.py").write_text(POLICIES)
    return workplace


def test_a_plan_for_a_vehicle_that_must_not_be_moved_is_reported(folder: Path) -> None:
    done = advdiff("check-policy", "our_policies:Everybody", *QUICK, cwd=folder)
    assert done.code == 1, done.err
    rows = [re.split(r"\s{2,}", line.strip()) for line in done.out.splitlines()]
    assert [row[1] for row in rows if row[0] == "fails"] == ["moves whom it may", "drives"]
    told = " ".join(done.out.split())
    assert "it plans for the target 'v" in told
    assert "plan for those of scene.movable, with the classes and sizes of scene.history" in told
    assert "background 'our_policies:Everybody' planned for the target" in told
    assert "(our_policies.py, line 18, plan)" in told
    assert "0 vehicles moved, 1 refused plan" in told
    assert done.out.strip().endswith("our_policies:Everybody: 2 of 12 checks fail")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("scriptd",), "did you mean 'scripted'"),
        (("our_policies:Nothing",), "lacks start and plan"),
        (("our_policies:Everybody", "--set", "background_options.second=2"), "did you mean 'seconds'"),
        (("our_policies:Everybody", "--set", "seconds=2"), "is background_options.seconds"),
    ],
)
def test_what_cannot_be_used(
    folder: Path, here: Callable[..., Outcome], words: tuple[str, ...], said: str
) -> None:
    done = here("check-policy", *words)
    assert (done.code, done.out) == (2, "")
    assert said in done.err
    assert "Traceback" not in done.err
