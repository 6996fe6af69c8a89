"""``advdiff-sumo check-planner`` as a user types it."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest

from tests.e2e.commands import Outcome


def test_plans_that_are_not_finite_are_reported(here: Callable[..., Outcome]) -> None:
    done = here(
        "check-planner", "our_planners:NotANumber", "--net", "grid.net.xml", "--episodes", 1, "--horizon", 4
    )
    assert done.code == 1, done.err
    rows = [re.split(r"\s{2,}", line.strip()) for line in done.out.splitlines()]
    assert [row[1] for row in rows if row[0] == "fails"] == ["numbers", "drives"]
    assert "xy_m holds values that are not finite" in done.out
    assert done.out.strip().endswith("our_planners:NotANumber: 2 of 10 checks fail")


def test_options_may_be_written_as_those_of_run(here: Callable[..., Outcome]) -> None:
    done = here("check-planner", "our_planners:NotANumber", "--set", "target_options.caution=1")
    assert done.code == 2
    assert "no option 'caution'; " in done.err


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("lane_grpah", "did you mean 'lane_graph'"),
        ("IDM", "driven by SUMO itself"),
        ("our_planners:Nothing", "lacks start and plan"),
        ("our_planners:Broken", "no weights found"),
    ],
)
def test_a_name_that_cannot_be_used(here: Callable[..., Outcome], name: str, words: str) -> None:
    done = here("check-planner", name)
    assert (done.code, done.out) == (2, "")
    assert words in done.err
    assert "Traceback" not in done.err
