"""Names, paths and messages with square brackets, which Rich could take for markup, are printed unchanged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from defusedxml.ElementTree import parse

from tests.e2e.commands import TINY, Outcome, advdiff

TAGGED = """
class Tagged:
    def start(self, road, scene, rng):
        raise ValueError("cannot parse tag [/lane]")

    def plan(self, road, scene, memory, rng):
        raise AssertionError
"""
SWEEP = """
episodes = 1
horizon_s = 1.0
scene = { warmup_s = 8.0, scenes_per_warmup = 1, min_neighbours = 1 }

[grid]
nets = ["grid.net.xml"]
targets = [{ name = "lane_graph", vary = { defects = [["late:weak"], ["range:strong"]] } }, "tagged:Tagged"]
backgrounds = ["replay"]
"""
PLACE = "runs/[red] ü x"


def test_a_sweep(workplace: Path) -> None:
    (workplace / "tagged.py").write_text(TAGGED)
    (workplace / "some.toml").write_text(SWEEP)
    words = ("--executor", "serial", "--out", PLACE, "--junit", "junit.xml", "--fail-if", "failures > 0")
    done = advdiff("sweep", "some.toml", *words, cwd=workplace, narrow=False)
    again = ("--junit", "again.xml", "--fail-if", "failures > 0")
    asked = advdiff("results", PLACE, *again, cwd=workplace, narrow=False)
    for outcome in (done, asked):
        assert outcome.code == 1, outcome.err
        assert "[late:weak]" in outcome.out
        assert "[range:strong]" in outcome.out
        assert "[/lane]" in outcome.out
        assert f"--sweep '{PLACE}'" in outcome.out
        assert f"results: {PLACE}\n" in outcome.out
        assert "--fail-if failures > 0: failures = 1" in outcome.out
    assert f"look at {PLACE}/report.html" in done.out
    for file in ("junit.xml", "again.xml"):
        assert parse(workplace / file).getroot().get("tests") == "4"

    sides = ("--a", "target=lane_graph", "--b", "target=tagged:Tagged")
    refused = advdiff("compare", PLACE, PLACE, *sides, cwd=workplace, narrow=False)
    assert refused.code == 2
    assert """: add --a 'target_options={"defects":["late:weak"]}' or --a 'target_options=""" in refused.err


def test_a_run(here: Callable[..., Outcome]) -> None:
    done = here("run", "--net", "grid.net.xml", "--episodes", 1, *TINY, "--out", PLACE)
    assert done.code == 0, done.err
    assert f"results: {PLACE}  ·  look at {PLACE}/report.html\n" in done.out
    again = here("replay", 0, "--run", PLACE, "--out", "runs/[bold]")
    assert "look at runs/[bold]/report.html" in again.out
