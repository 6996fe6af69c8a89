"""Names, paths and messages with square brackets, in which Rich would see colours, come out as they are."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

from defusedxml.ElementTree import parse

from tests.e2e.commands import MODULE, TINY, Outcome, environment
from tests.hang_guard import HANG_S

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


def piped(place: Path, *words: object) -> Outcome:
    """Run a command whose output goes into a pipe, where tables are as wide as what is in them."""
    wide = {name: value for name, value in environment().items() if name != "COLUMNS"}
    command = [*MODULE, *map(str, words)]
    done = subprocess.run(
        command, cwd=place, env=wide, capture_output=True, text=True, check=False, timeout=HANG_S
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


def test_a_sweep(workplace: Path) -> None:
    (workplace / "tagged.py").write_text(TAGGED)
    (workplace / "some.toml").write_text(SWEEP)
    words = ("--executor", "serial", "--out", PLACE, "--junit", "junit.xml", "--fail-if", "failures > 0")
    done = piped(workplace, "sweep", "some.toml", *words)
    asked = piped(workplace, "results", PLACE, "--junit", "again.xml", "--fail-if", "failures > 0")
    for outcome in (done, asked):
        assert outcome.code == 1, outcome.err
        assert "[late:weak]" in outcome.out
        assert "[range:strong]" in outcome.out
        assert "[/lane]" in outcome.out
        assert f"results: {PLACE}\n" in outcome.out
        assert "--fail-if failures > 0: failures = 1" in outcome.out
    assert f"look at {PLACE}/report.html" in done.out
    for file in ("junit.xml", "again.xml"):
        assert parse(workplace / file).getroot().get("tests") == "4"

    refused = piped(
        workplace, "compare", PLACE, PLACE, "--a", "target=lane_graph", "--b", "target=tagged:Tagged"
    )
    assert refused.code == 2
    assert """: add --a 'target_options={"defects":["late:weak"]}' or --a 'target_options=""" in refused.err


def test_a_run(here: Callable[..., Outcome]) -> None:
    done = here("run", "--net", "grid.net.xml", "--episodes", 1, *TINY, "--out", PLACE)
    assert done.code == 0, done.err
    assert f"results: {PLACE}  ·  look at {PLACE}/report.html\n" in done.out
    again = here("replay", 0, "--run", PLACE, "--out", "runs/[bold]")
    assert "look at runs/[bold]/report.html" in again.out
