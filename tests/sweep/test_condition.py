"""``--fail-if``: comparisons of figures and nothing else."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.sweep.condition import Condition, Undefined
from advdiff_sumo.sweep.paired import COMPARED_NAMES
from advdiff_sumo.sweep.summary_stats import FIGURE_NAMES

NAMES = frozenset({"collision_rate", "episodes", "median_min_ttc_s"})
FIGURES = {"collision_rate": 0.1, "episodes": 40.0, "median_min_ttc_s": None}


@pytest.mark.parametrize(
    ("text", "met"),
    [
        ("collision_rate>0.05", True),
        ("collision_rate > 0.1", False),
        ("collision_rate >= 0.1", True),
        ("0.05 < collision_rate < 0.2", True),
        ("0.05 < collision_rate < 0.06", False),
        ("episodes == 40 and not collision_rate > 0.5", True),
        ("episodes < 40 or collision_rate != 0.1", False),
        ("collision_rate * episodes > 3.9", True),
        ("-collision_rate < -0.2 or episodes - 1 <= 39", True),
        ("(episodes > 100 or collision_rate > 0.05) and episodes > 50", False),
        ("episodes < 10 and median_min_ttc_s < 1", False),
    ],
)
def test_values(text: str, met: bool) -> None:
    assert Condition(text, NAMES).holds(FIGURES) is met


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "is no condition"),
        ("collision_rate >", "is no condition"),
        ("collision_rate", "compares nothing"),
        ("colision_rate > 1", "did you mean 'collision_rate'"),
        ("__import__('os').system('true') > 0", "neither a figure nor a number"),
        ("collision_rate.__class__ > 0", "neither a figure nor a number"),
        ("collision_rate ** 9 > 0", "neither a figure nor a number"),
        ("[1 for x in range(9)] > 0", "neither a figure nor a number"),
        ("collision_rate > True", "neither a figure nor a number"),
        ("collision_rate > '0.05'", "neither a figure nor a number"),
        ("collision_rate in episodes", "compares nothing"),
        ("(x := 1) > 0", "neither a figure nor a number"),
        ("1 > " + "(" * 300 + "1" + ")" * 300, "longer than"),
    ],
)
def test_anything_else_is_refused(text: str, word: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Condition(text, NAMES)
    assert word in str(caught.value)


def test_the_example_uses_figures_of_the_verb() -> None:
    with pytest.raises(ConfigError, match="write it like valid_failure_rate > 0 and episodes >= 100"):
        Condition("true", FIGURE_NAMES)
    with pytest.raises(ConfigError, match="write it like valid_failure_rate_only_b > 0 or unpaired > 0"):
        Condition("true", COMPARED_NAMES)


def test_an_undefined_figure_is_not_false() -> None:
    with pytest.raises(Undefined, match="median_min_ttc_s"):
        Condition("median_min_ttc_s < 1", NAMES).holds(FIGURES)
    with pytest.raises(ConfigError, match="divides by zero"):
        Condition("episodes / 0 > 1", NAMES).holds(FIGURES)


@pytest.mark.parametrize("text", ["episodes / 0 > 1", "1 / (2 - 2) > 0", "episodes > 1 or 1 / -0.0 > 0"])
def test_a_certain_division_by_zero_is_refused_before_the_first_episode(text: str) -> None:
    with pytest.raises(ConfigError, match="divides by zero; write it like"):
        Condition(text, NAMES)


def test_a_quotient_of_a_figure_that_is_zero_is_undefined() -> None:
    condition = Condition("episodes > 1 and collision_rate / (episodes - 40) > 1", NAMES)
    words = r"^divides by zero, with collision_rate = 0\.1, episodes = 40$"
    with pytest.raises(Undefined, match=words):
        condition.holds(FIGURES)
    assert condition.holds({**FIGURES, "episodes": 40.01})  # 0.1 / 0.01 = 10


def test_a_condition_names_its_figures_also_undefined_ones() -> None:
    text = "episodes > 1 or median_min_ttc_s < 1"
    assert Condition(text, NAMES).values_text(FIGURES) == "episodes = 40, median_min_ttc_s is undefined"
    assert Condition("1 > 0", NAMES).values_text(FIGURES) == ""


@given(st.text(max_size=60))
def test_any_text_is_refused_or_evaluated(text: str) -> None:
    try:
        condition = Condition(text, NAMES)
    except ConfigError:
        return
    with contextlib.suppress(ConfigError, Undefined):
        assert condition.holds(FIGURES) in (True, False)
