"""``sweep --diverse`` chooses attacks and seed scenes in rounds; the choice does not depend on how it is run."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from advdiff_sumo.traffic.attack_names import KIND_NAMES
from tests.e2e.commands import Outcome

SWEEP = """
episodes = {episodes}
horizon_s = 8.0
scene = {{ warmup_s = 8.0, scenes_per_warmup = 5, min_neighbours = 1 }}

[grid]
nets = ["grid.net.xml"]
targets = ["IDM"]
backgrounds = ["{background}"]
"""
TABLES = ("episodes.parquet", "states.parquet", "collisions.parquet", "failures.parquet")


def sweep_file(folder: Path, episodes: int, background: str = "scripted") -> None:
    (folder / "wide.toml").write_text(SWEEP.format(episodes=episodes, background=background))


def test_sweeps_that_cannot_be_diverse_are_refused(workplace: Path, here: Callable[..., Outcome]) -> None:
    sweep_file(workplace, 2, "sumo")
    refused = here("sweep", "wide.toml", "--diverse", "--dry-run")
    assert refused.code == 2
    assert "no background here has several; take scripted or diffusion" in refused.err
    sweep_file(workplace, 1)
    words = ("--executor", "serial", "--no-report")
    assert here("sweep", "wide.toml", "--out", "plain", *words).code == 0
    again = here("sweep", "--resume", "plain", "--diverse", *words)
    assert again.code == 2
    assert "that sweep was begun without --diverse" in again.err


@pytest.mark.slow
def test_the_same_episodes_however_it_is_run(workplace: Path, here: Callable[..., Outcome]) -> None:
    """Run ten episodes in rounds of eight with one worker, with two, and with an interruption within a round."""
    sweep_file(workplace, 10)
    one = here("sweep", "wide.toml", "--diverse", "--executor", "serial", "--out", "one")
    assert one.code == 0, one.err
    assert here("sweep", "wide.toml", "--diverse", "--workers", "2", "--out", "two", "--no-report").code == 0
    cut = here("sweep", "wide.toml", "--diverse", "--limit", "5", "--out", "cut", "--no-report")
    assert cut.code == 0, cut.err
    assert "5 episodes not run yet" in cut.out
    assert here("results", "cut", "--fail-if", "missing != 5").code == 0
    lacking = here("results", "cut", "--fail-if", "missing > 0")
    assert (lacking.code, "5 episodes not run yet" in lacking.out) == (1, True)
    assert here("sweep", "--resume", "cut", "--no-report").code == 0
    for name in (*TABLES, "rounds.json"):
        whole = (workplace / "one" / name).read_bytes()
        assert (workplace / "two" / name).read_bytes() == whole, name
        assert (workplace / "cut" / name).read_bytes() == whole, name
    rows = pq.read_table(workplace / "one" / "episodes.parquet").to_pylist()
    chosen = json.loads((workplace / "one" / "rounds.json").read_text(encoding="utf-8"))["episodes"]
    assert [row["key"] for row in rows] == chosen
    assert len({row["attack"] for row in rows}) == 10
    assert re.search(r"archive: encounters of [1-9]\d* kinds?, valid failures in \d+ of them", one.out)
    assert 'id="archive"' in (workplace / "one" / "report.html").read_text(encoding="utf-8")
    assert "archive:" in here("results", "one").out
    (workplace / "two" / "rounds.json").write_text("{")
    damaged = here("results", "two")
    assert damaged.code == 2
    assert "rounds.json: is damaged" in damaged.err
    (workplace / "two" / "rounds.json").unlink()
    assert here("sweep", "--resume", "two", "--no-report").code == 0
    assert json.loads((workplace / "two" / "rounds.json").read_text(encoding="utf-8"))["episodes"] == chosen


@pytest.mark.slow
def test_a_dry_run_counts_the_requested_episodes(workplace: Path, here: Callable[..., Outcome]) -> None:
    sweep_file(workplace, 3)
    dry = here("sweep", "wide.toml", "--diverse", "--dry-run")
    assert dry.code == 0, dry.err
    assert f"3 episodes in {len(KIND_NAMES)} runs; 3 to do" in dry.out
