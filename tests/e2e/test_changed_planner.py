"""A resumed sweep or run prints a note if the file of the planner has changed since it was begun."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.e2e.commands import Outcome

PLANNER = """
import numpy as np
from advdiff_sumo.core.plan import Controls

class Onward:
    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        return Controls(np.full(10, 0.1), np.zeros(10), 0.1), None
"""
SWEEP = """
episodes = 2
horizon_s = 1.0
scene = { warmup_s = 8.0, scenes_per_warmup = 2, min_neighbours = 1 }

[grid]
nets = ["grid.net.xml"]
targets = ["onward:Onward"]
backgrounds = ["sumo"]
"""
NOTE = "note: the file of onward:Onward has changed since this was begun"


@pytest.mark.parametrize("verb", ["sweep", "run"])
def test_a_note_says_that_the_planner_has_changed(
    workplace: Path, here: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    monkeypatch.delitem(sys.modules, "onward", raising=False)  # imported by the other case of this test
    (workplace / "onward.py").write_text(PLANNER)
    (workplace / "small.toml").write_text(SWEEP)
    options = ("--net", "grid.net.xml", "--target", "onward:Onward", "--horizon", "1", "--out", "made")
    begin, go_on = {
        "sweep": (
            ("sweep", "small.toml", "--out", "made", "--executor", "serial", "--limit", "1", "--no-report"),
            ("sweep", "--resume", "made", "--executor", "serial", "--no-report"),
        ),
        "run": (
            ("run", *options, "--episodes", "1", "--set", "scene.warmup_s=8"),
            ("run", "--resume", "--out", "made", "--episodes", "2"),
        ),
    }[verb]
    begun = here(*begin)
    assert (begun.code, NOTE in begun.err) == (0, False), begun.err
    same = here(*go_on)
    assert (same.code, NOTE in same.err) == (0, False), same.err
    (workplace / "onward.py").write_text(PLANNER.replace("0.1)", "-0.1)"))
    for _ in range(2):
        changed = here(*go_on)
        assert (changed.code, NOTE in " ".join(changed.err.split())) == (0, True), changed.err
