"""Turns, vehicles and manoeuvres follow what is predicted of the target; without a prediction nothing changes."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.failure_predictor import FailurePredictor
from advdiff_sumo.traffic.manoeuvres.choice import rank
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.encounter_features import FEATURES
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference, answers
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.schedule import advance
from tests.traffic.manoeuvres.scenes import view_of

COUNT = len(FEATURES)
EPISODES = 200


def who_fails(explores: float = 0.0, **coefficients: float) -> EncounterPreference:
    """Return a preference for a target with these coefficients, beside a logit of −3 for every kind."""
    mean = np.where(np.arange(COUNT) < len(KINDS), -3.0, 0.0)
    for name, value in coefficients.items():
        mean[FEATURES.index(name.replace("_", "-") if name in ("hard_stop", "cut_in") else name)] += value
    predictor = FailurePredictor(mean, 1e-9 * np.eye(COUNT), np.eye(len(KINDS), COUNT))
    return EncounterPreference(predictor, explores)


def starts(preference: EncounterPreference | None, attack: str = "any") -> list[Commitments]:
    return [
        Commitments.start(attack, np.random.default_rng(k), 6, preference=preference) for k in range(EPISODES)
    ]


def test_lorries_come_for_who_does_not_see_them() -> None:
    """They are four in ten where nothing is known.

    A target that fails with a lorry in σ(−2) = 12 %, else in σ(−3) = 5 %, meets one for a share of 0.4 · 0.12³ to
    0.6 · 0.05³: 90 %.
    """
    share = {
        bool(known): np.mean([[c == AgentClass.TRUCK for c in one.stage.classes] for one in starts(known)])
        for known in (None, who_fails(heavy=1.0))
    }
    assert share[False] == pytest.approx(0.4, abs=0.03)
    assert share[True] == pytest.approx(0.90, abs=0.03)


def test_the_episodes_of_a_warm_up_take_turns() -> None:
    """Three stops, by a car, a lorry and a motorcycle; where a kind has no place it is a stop."""
    preference = who_fails(heavy=6.0)
    probes = [
        Commitments.start("any", np.random.default_rng(0), 6, preference=replace(preference, probe=k))
        for k in range(5)
    ]
    assert [one.agenda.order for one in probes[:4]] == [("hard-stop",)] * 3 + [("cut-in", "hard-stop")]
    assert [one.stage.agent_class.name for one in probes[:4]] == ["CAR", "TRUCK", "MOTORCYCLE", "CAR"]
    assert probes[4].agenda.order == ("crossing", "hard-stop")


def test_a_stop_answers_no_question_about_cut_ins() -> None:
    """Questions 1 and 3: a stop by a lorry, a cut-in by a car; a stop by a car answers neither."""

    def met(kind: str, heavy: float) -> np.ndarray:
        one = np.zeros((1, COUNT))
        one[0, [FEATURES.index(kind), FEATURES.index("heavy")]] = 1.0, heavy
        return one

    stop, lorry, cut_in = met("hard-stop", 0.0), met("hard-stop", 1.0), met("cut-in", 0.0)
    assert [answers(1, one) for one in (stop, lorry, cut_in)] == [False, True, False]
    assert [answers(3, one) for one in (stop, lorry, cut_in)] == [False, False, True]
    assert not answers(3, np.concatenate((stop, met("cut-in", 1.0))))  # neither is both
    assert answers(3, np.concatenate((stop, cut_in)))
    assert not answers(0, np.zeros((0, COUNT)))


def test_turns_go_to_the_kind_that_breaks_it() -> None:
    preferred = [one.agenda for one in starts(who_fails(cut_in=6.0))]
    first = Counter(one.order[0] for one in preferred)
    assert first["cut-in"] > 0.75 * EPISODES
    assert all(
        {"hard-stop", "cut-in", "crossing"} <= {*one.order} for one in preferred
    )  # where it has no place
    assert not any(one.crosses_any_time for one in preferred)  # it would keep the others away
    assert all(one.agenda.crosses_any_time for one in starts(who_fails()))


def test_somebody_comes_from_where_it_does_not_see() -> None:
    assert np.mean([one.stage.oncoming for one in starts(who_fails(oncoming=6.0))]) > 0.9


def test_some_episodes_draw_as_if_nothing_were_known() -> None:
    plain, all_explore = starts(None), starts(who_fails(explores=1.0, heavy=6.0))
    assert [(a.stage, a.agenda, a.weights) for a in all_explore] == [
        (a.stage, a.agenda, a.weights) for a in plain
    ]


def test_one_kind_alone_keeps_its_draws() -> None:
    plain, known = starts(None, "cut-in"), starts(who_fails(heavy=6.0), "cut-in")
    assert [(a.stage, a.agenda) for a in known] == [(a.stage, a.agenda) for a in plain]


@pytest.mark.parametrize(
    ("attack", "heavy", "begins"), [("hard-stop", 0.0, True), ("hard-stop", 6.0, False), ("any", 0.0, False)]
)
def test_the_one_kind_asked_for_begins_however_much_others_promise(
    attack: str, heavy: float, begins: bool, motorway: RoadMap
) -> None:
    """A stop promises 5 %, a cut-in 95 %: the fifth of it that any encounter has to promise is 19 %.

    Among stops alone it is 1 % unless a lorry promises more.
    """
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 90.0, 20.0))
    kept = Commitments.start(attack, np.random.default_rng(0), preference=who_fails(cut_in=6.0, heavy=heavy))
    assert kept.preference is not None
    ranked = rank(view, list(KINDS["hard-stop"](view, 1)), {"hard-stop": 1.0}, preference=kept.preference)
    assert any(not one.manoeuvre.sets_up for one in ranked) == begins


def test_manoeuvres_are_ranked_by_predicted_failures(motorway: RoadMap) -> None:
    """A leader brakes so that 5 or 6 m/s² are needed: more is better, unless the target fails where less is."""
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 90.0, 20.0))
    proposals = [one for one in KINDS["hard-stop"](view, 1) if not one.sets_up]
    weights = {"hard-stop": 1.0}
    plain = rank(view, proposals, weights)
    assert len({one.needed_mps2 for one in plain}) > 1
    gentle = rank(view, proposals, weights, preference=who_fails(needed_braking=-20.0))
    assert gentle[0].needed_mps2 == min(one.needed_mps2 for one in plain)
    assert {one.merit for one in gentle} == {one.merit for one in plain}
    assert all(len(one.features) == COUNT for one in gentle)
    assert all(one.features == () for one in plain)


def test_what_keeps_a_far_better_encounter_away_does_not_begin(motorway: RoadMap) -> None:
    """A car that stops promises 5 % where a lorry promises 95: it would take the lorry's place."""
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 90.0, 20.0))
    proposals = list(KINDS["hard-stop"](view, 1))
    for preference, begins in (
        (who_fails(), True),
        (who_fails(heavy=6.0), False),
        (who_fails(1.0, heavy=6.0), True),
    ):
        explored = preference.draw(np.random.default_rng(0), {AgentClass.CAR: 1.0}, 1)[1]
        ranked = rank(view, proposals, {"hard-stop": 1.0}, preference=explored)
        assert any(not one.manoeuvre.sets_up for one in ranked) == begins


def test_an_encounter_keeps_its_features(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 90.0, 20.0))
    begun = Commitments.start("hard-stop", np.random.default_rng(0), preference=who_fails())
    _, memory = advance(view, begun, 2, 8.0)
    assert len(memory.active["leader"].features) == COUNT
    _, plain = advance(view, replace(begun, preference=None), 2, 8.0)
    assert plain.active["leader"].features == ()
