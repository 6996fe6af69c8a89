"""Bisection of a severity, worked by hand and for any threshold."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.experiments.margin import (
    BRAKING,
    GAP,
    REVEAL,
    SCALES,
    TIME,
    Margin,
    Scale,
    Trial,
    bisect,
    scale_of,
)
from advdiff_sumo.traffic.manoeuvres.intensity import SEVERITY_KINDS
from advdiff_sumo.traffic.policy_registry import make_policy
from advdiff_sumo.traffic.scripted.scripted_policy import ScriptedTraffic

TO_NINE = Scale("braking", "braking_mps2", "m/s²", 1.0, 9.0, 0.25, "braking of {}")


def failing(fails: Callable[[float], bool]) -> Callable[[float], Trial]:
    return lambda value: Trial(value, fails(value), met=True)


def test_the_neighbours_by_hand() -> None:
    """Between 1 and 9, to 2: 9 fails, 1 passes, 5 fails, 3 passes."""
    margin = bisect(failing(lambda value: value >= 4.0), TO_NINE, within=2.0)
    assert [(trial.value, trial.failed) for trial in margin.trials] == [
        (9.0, True),
        (1.0, False),
        (5.0, True),
        (3.0, False),
    ]
    assert [trial.value for trial in margin.neighbours] == [5.0, 3.0]
    assert margin.text("hard-stop", TO_NINE) == (
        "copes with hard-stop at braking of 3 m/s² and fails at braking of 5 m/s²"
    )


def test_a_small_gap_is_severe() -> None:
    """From 25 m to 0 m beyond the lawful gap, to 5 m: it fails up to 10 m and passes from 15 m on."""
    margin = bisect(failing(lambda gap: gap < 12.0), GAP, within=5.0)
    assert [trial.value for trial in margin.neighbours] == [10.0, 15.0]
    assert "copes with cut-in at 15 m beyond the lawful gap and fails at 10 m" in margin.text("cut-in", GAP)


@pytest.mark.parametrize(
    ("threshold", "values", "text"),
    [
        (10.0, [9.0], "copes with hard-stop up to the severest, braking of 9 m/s²"),
        (0.5, [9.0, 1.0], "fails at the mildest hard-stop already, braking of 1 m/s²"),
    ],
)
def test_nothing_or_all_fails(threshold: float, values: list[float], text: str) -> None:
    margin = bisect(failing(lambda value: value >= threshold), TO_NINE, within=1.0)
    assert [trial.value for trial in margin.trials] == values
    assert len(margin.neighbours) == 1
    assert margin.text("hard-stop", TO_NINE) == text


def test_milder_values_are_tried_where_the_severest_encounter_does_not_take_place() -> None:
    """Steps of 1 from 1 to 9: it takes place up to 6 m/s² and fails from 4 m/s² on."""
    runs = lambda value: Trial(value, 4.0 <= value <= 6.0, met=value <= 6.0)  # noqa: E731 - one line says it
    stopped = bisect(runs, TO_NINE, within=1.0)
    assert [trial.value for trial in stopped.trials] == [9.0]
    margin = bisect(runs, TO_NINE, within=1.0, descends=True)
    assert [trial.value for trial in margin.trials] == [9.0, 8.0, 7.0, 6.0, 1.0, 3.0, 4.0]
    assert [trial.value for trial in margin.neighbours] == [4.0, 3.0]


def test_the_descent_ends_in_the_middle_and_at_the_first_encounter() -> None:
    nobody = bisect(lambda value: Trial(value, failed=False, met=False), TO_NINE, 1.0, descends=True)
    assert [trial.value for trial in nobody.trials] == [9.0, 8.0, 7.0, 6.0, 5.0]
    assert not nobody.is_known
    copes = bisect(lambda value: Trial(value, failed=False, met=value < 8.0), TO_NINE, 1.0, descends=True)
    assert [trial.value for trial in copes.trials] == [9.0, 8.0, 7.0]
    assert copes.text("cut-in", TO_NINE) == (
        "copes with cut-in up to braking of 7 m/s²; a more severe one did not take place"
    )


def test_that_nobody_met_the_target_is_no_success() -> None:
    nobody = Margin(Trial(8.5, failed=False, met=False), None, ())
    assert "nobody was in a position for hard-stop" in nobody.text("hard-stop", BRAKING)


def test_what_lacked_is_told_with_what_to_do() -> None:
    nobody = Margin(Trial(8.5, failed=False, met=False, lacks="the target stood"), None, ())
    assert nobody.text("hard-stop", BRAKING) == (
        "nobody was in a position for hard-stop: the target stood; "
        "raise scene.min_speed_mps or choose a scene.situation with --set, or take another --seed or --net"
    )


def test_where_nobody_attacked_there_is_no_answer() -> None:
    fails, passes = Trial(2.0, failed=True, met=True), Trial(1.75, failed=False, met=True)
    nobody = Trial(8.5, failed=False, met=False)
    assert Margin(passes, fails, ()).is_known
    assert Margin(passes, None, ()).is_known
    assert Margin(None, fails, ()).is_known
    assert Margin(nobody, fails, ()).is_known
    assert not Margin(nobody, None, ()).is_known


def test_what_is_not_the_encounter_is_told() -> None:
    fails, passes = Trial(2.0, failed=True, met=True), Trial(1.75, failed=False, met=False)
    text = Margin(passes, fails, ()).text("hard-stop", BRAKING)
    assert text == (
        "copes with hard-stop at braking of 1.75 m/s² (no encounter) and fails at braking of 2 m/s²"
    )
    by_chance = Margin(None, Trial(1.0, failed=True, met=False), ()).text("hard-stop", BRAKING)
    assert by_chance == (
        "fails at the mildest hard-stop already, braking of 1 m/s²: "
        "it collides with somebody who does nothing against it"
    )
    alone = Margin(None, Trial(1.0, failed=True, met=False, left_road=True), ()).text("hard-stop", BRAKING)
    assert alone == (
        "fails at the mildest hard-stop already, braking of 1 m/s²: "
        "it leaves the road by itself and touches nobody"
    )


@given(
    threshold=st.floats(0.001, 1.0),
    within=st.floats(0.05, 3.0),
    scale=st.sampled_from([TO_NINE, GAP, TIME, REVEAL]),
)
def test_the_threshold_lies_between_the_neighbours(threshold: float, within: float, scale: Scale) -> None:
    span = scale.severest - scale.mildest
    margin = bisect(failing(lambda value: (value - scale.mildest) / span >= threshold - 1e-6), scale, within)
    fails, passes = margin.neighbours
    assert fails.failed
    assert not passes.failed
    assert abs(fails.value - passes.value) <= within + 1e-5
    assert len(margin.trials) <= 2 + (abs(span) / within).__ceil__().bit_length()


def test_each_severity_is_an_option_of_the_background_at_both_ends() -> None:
    for attack, scales in SCALES.items():
        for scale in scales:
            for value in (scale.mildest, scale.severest):
                policy = make_policy("scripted", {"attack": attack, scale.option: value})
                assert isinstance(policy, ScriptedTraffic)
                assert getattr(policy.options, scale.option) == value


def test_what_is_no_severity_is_refused() -> None:
    assert scale_of("cut-in") is GAP
    assert scale_of("cut-in", "braking") is BRAKING
    assert scale_of("cut-out") is scale_of("cut-out", "time") is REVEAL
    with pytest.raises(ConfigError, match="--attack any: a margin is known for"):
        scale_of("any")
    with pytest.raises(ConfigError, match="--by gap: crossing is as severe as its time"):
        scale_of("crossing", "gap")


def test_every_kind_with_a_severity_has_a_scale() -> None:
    assert tuple(SCALES) == SEVERITY_KINDS
