"""``--licence`` and the background ``scripted`` from the command line."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import TINY, advdiff, bytes_of


@pytest.mark.slow
def test_a_lawful_run_and_the_same_again(tmp_path: Path) -> None:
    words = ("run", "--background", "scripted", "--licence", "lawful", "--episodes", "2", *TINY)
    first = advdiff(*words, "--out", "first", cwd=tmp_path)
    assert first.code == 0, first.err
    assert advdiff(*words, "--out", "again", cwd=tmp_path, hash_seed=1).code == 0
    assert bytes_of(tmp_path / "first") == bytes_of(tmp_path / "again")
    rows = pq.read_table(tmp_path / "first" / "episodes.parquet").to_pylist()
    assert [row["end"] for row in rows] != ["failed", "failed"]


def test_a_licence_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    outcome = advdiff("run", "--background", "scripted", "--licence", "legal", cwd=tmp_path)
    assert outcome.code == 2
    assert "licence = 'legal'" in outcome.err
    assert "lawful" in outcome.err


@pytest.mark.slow
def test_a_run_reports_episodes_in_which_no_vehicle_could_attack(tmp_path: Path) -> None:
    """On a motorway, no vehicle can cross the target's path."""
    words = (
        "run",
        "--net",
        "motorway",
        "--background",
        "scripted",
        "--attack",
        "crossing",
        "--episodes",
        "2",
    )
    outcome = advdiff(*words, *TINY, "--out", "run", cwd=tmp_path)
    assert outcome.code == 0, outcome.err
    said = " ".join(outcome.out.split())
    assert "episode 0: no one was in a position to cross its way" in said
    assert "episode 1: no one was in a position to cross its way" in said
    assert "in 2 of 2 episodes" in said
    rows = pq.read_table(tmp_path / "run" / "episodes.parquet").to_pylist()
    assert [(row["attack_kind"], row["in_position"]) for row in rows] == [("crossing", False)] * 2


@pytest.mark.slow
def test_a_sweep_reports_them_too(tmp_path: Path) -> None:
    lines = (
        "episodes = 1",
        "horizon_s = 1.0",
        "scene.warmup_s = 5.0",
        'grid.nets = ["motorway"]',
        'grid.targets = ["IDM"]',
        'grid.backgrounds = [{name = "scripted", options = {attack = "crossing"}}]',
    )
    (tmp_path / "one.toml").write_text("\n".join(lines))
    outcome = advdiff("sweep", "one.toml", "--workers", 1, "--out", "sweep", cwd=tmp_path)
    assert outcome.code == 0, outcome.err
    assert "no one was in a position to cross its way in 1 of 1 episodes" in outcome.out
