"""``--defect`` and ``advdiff-sumo defects`` as a user types them."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import TINY, Outcome, advdiff

RUN = ("run", "--net", "motorway", "--target", "lane_graph", "--episodes", "2", *TINY)


def test_a_run_with_defects_is_repeated_by_its_own_file(tmp_path: Path) -> None:
    planted = ("--defect", "localisation:2m", "--defect", "flicker:middle")
    first = advdiff(*RUN, *planted, "--out", "first", cwd=tmp_path)
    assert first.code == 0, first.err
    settings = tomllib.loads((tmp_path / "first" / "run.toml").read_text())
    assert settings["options"]["target_options"] == {"defects": ["localisation:2m", "flicker:middle"]}
    again = advdiff("run", "--config", "first/run.toml", "--out", "again", cwd=tmp_path, hash_seed=2)
    assert again.code == 0, again.err
    sound = advdiff(*RUN, "--out", "sound", cwd=tmp_path)
    assert sound.code == 0, sound.err
    states = {name: pq.read_table(tmp_path / name / "states.parquet") for name in ("first", "again", "sound")}
    assert states["first"].equals(states["again"])
    assert not states["first"].equals(states["sound"])


def test_a_planner_of_the_users_own_with_a_defect_keeps_the_contract(here: Callable[..., Outcome]) -> None:
    words = (
        "--net",
        "grid.net.xml",
        "--episodes",
        1,
        "--horizon",
        4,
        "--within-ms",
        1e6,
        "--defect",
        "late:1.0",
    )
    done = here("check-planner", "our_planners:Patient", *words)
    assert done.code == 0, done.out
    refused = here("check-planner", "lane_graph", *words[:-1], "slow-breaks:1")
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "unknown defect 'slow-breaks'; did you mean 'slow-brakes'?" in refused.err


@pytest.mark.parametrize(
    ("target", "defect", "said"),
    [
        ("lane_graph", "late:stong", "did you mean 'strong'?"),
        ("lane_graph", "late", "defect 'late' lacks its severity; give weak (0.5 s)"),
        ("lane_graph", "range:5s", "its unit is 'm', not 's'"),
        ("IDM", "tunnel:strong", "defect 'tunnel' has no form for target 'IDM', which SUMO drives"),
    ],
)
def test_a_defect_that_cannot_be_planted_gets_a_sentence(
    target: str, defect: str, said: str, here: Callable[..., Outcome]
) -> None:
    done = here("run", "--net", "grid.net.xml", "--target", target, "--defect", defect, "--out", "out")
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert said in done.err
