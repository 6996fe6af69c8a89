"""If a user's planner fails, its episodes fail, and the run continues."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import TINY, Outcome


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("Raises", "planner_error", ("our_planners:Raises", "RuntimeError", "out of ideas")),
        ("NotANumber", "plan_refused", ("our_planners:NotANumber", "not numbers")),
        ("Jumps", "plan_refused", ("our_planners:Jumps", "planned a jump of 70.7 m in 0.1 s")),
    ],
)
def test_a_failing_planner(
    here: Callable[..., Outcome], workplace: Path, name: str, kind: str, words: tuple[str, ...]
) -> None:
    target = f"our_planners:{name}"
    done = here("run", "--net", "grid.net.xml", "--target", target, "--episodes", 2, *TINY, "--out", "run")
    assert done.code == 1, done.err
    assert "Traceback" not in done.out + done.err
    assert "2 of 2" in next(line for line in done.out.splitlines() if "failed episodes" in line)
    rows = pq.read_table(workplace / "run" / "episodes.parquet").to_pylist()
    assert [(row["episode"], row["end"], row["failure_kind"]) for row in rows] == [
        (0, "failed", kind),
        (1, "failed", kind),
    ]
    for word in words:
        assert word in rows[0]["failure_message"]
    states = pq.read_table(workplace / "run" / "states.parquet").to_pylist()
    assert {row["episode"] for row in states} == {0, 1}
    assert {row["step"] for row in states} == {0}


def test_more_episodes_are_added_to_a_finished_run(here: Callable[..., Outcome], workplace: Path) -> None:
    words = ("run", "--net", "grid.net.xml", *TINY)
    assert here(*words, "--episodes", 1, "--out", "run").code == 0
    assert here("run", "--resume", "--out", "run", "--episodes", 3).code == 0
    assert here(*words, "--episodes", 3, "--out", "at once").code == 0
    for name in ("episodes.parquet", "states.parquet", "collisions.parquet", "run.toml"):
        assert (workplace / "run" / name).read_bytes() == (workplace / "at once" / name).read_bytes(), name


def test_without_out_the_folder_is_named_after_the_run(here: Callable[..., Outcome], workplace: Path) -> None:
    words = ("run", "--net", "grid.net.xml", "--target", "our_planners:Raises", "--episodes", 1, *TINY)
    assert here(*words).code == 1
    assert here(*words).code == 1
    names = sorted(path.name for path in (workplace / "runs").iterdir())
    assert names == ["grid-our_planners-Raises-sumo-s0", "grid-our_planners-Raises-sumo-s0-2"]
