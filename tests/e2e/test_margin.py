"""``advdiff-sumo margin`` from the command line."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import advdiff

SCENE = (
    *("--net", "motorway", "--target", "lane_graph", "--seed", "3", "--horizon", "8"),
    *("--set", "scene.situation=following", "--set", "scene.min_speed_mps=8"),
    *("--set", "scene.warmup_s=20", "--set", "scene.scenes_per_warmup=1"),
)


def test_an_attack_without_a_severity_is_refused(tmp_path: Path) -> None:
    outcome = advdiff("margin", "--attack", "crossing", cwd=tmp_path)
    assert outcome.code == 2
    assert "--attack crossing: a margin is known for hard-stop, cut-in" in outcome.err


@pytest.mark.slow
def test_the_failing_and_the_passing_neighbour_and_again(tmp_path: Path) -> None:
    words = ("margin", *SCENE, "--defect", "weak-brakes:3", "--within", "4", "--out", "m")
    done = advdiff(*words, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "lane_graph copes with hard-stop at" in done.out
    failing, passing = pq.read_table(tmp_path / "m" / "episodes.parquet").to_pylist()
    assert (failing["valid_failure"], passing["valid_failure"]) == (True, False)
    assert (tmp_path / "m" / "report.html").is_file()
    lines = (tmp_path / "m" / "margin.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "braking_mps2,valid_failure"
    assert lines[-1] == "9,true"
    again = advdiff(*words, cwd=tmp_path)
    assert again.out == done.out
