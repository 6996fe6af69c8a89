"""Turns, vehicles and manoeuvres follow the predictions about the target; without a prediction nothing changes."""

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
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference, is_probed
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.schedule import update_manoeuvres
from tests.traffic.manoeuvres.scenes import view_of

COUNT = len(FEATURES)
EPISODES = 200


def preference_for(exploration_share: float = 0.0, **coefficients: float) -> EncounterPreference:
    """Return a preference for a target with these coefficients, beside a logit of −3 for every kind."""
    mean = np.where(np.arange(COUNT) < len(KINDS), -3.0, 0.0)
    for name, value in coefficients.items():
        mean[FEATURES.index(name.replace("_", "-") if name in ("hard_stop", "cut_in") else name)] += value
    predictor = FailurePredictor(mean, 1e-9 * np.eye(COUNT), np.eye(len(KINDS), COUNT))
    return EncounterPreference(predictor, exploration_share)


def starts(preference: EncounterPreference | None, attack: str = "any") -> list[Commitments]:
    return [
        Commitments.start(attack, np.random.default_rng(k), 6, preference=preference) for k in range(EPISODES)
    ]


def test_lorries_are_inserted_more_often_for_a_target_that_does_not_see_them() -> None:
    """Without predictions they are four in ten.

    A target fails with a lorry in σ(−2) = 12 %, else in σ(−3) = 5 %. The weights are 0.4 · 0.12³ and 0.6 · 0.05³, so
    90 % are lorries.
    """
    share = {
        bool(known): np.mean(
            [[c == AgentClass.TRUCK for c in memory.stage.classes] for memory in starts(known)]
        )
        for known in (None, preference_for(heavy=1.0))
    }
    assert share[False] == pytest.approx(0.4, abs=0.03)
    assert share[True] == pytest.approx(0.90, abs=0.03)


def test_the_episodes_of_a_warm_up_take_turns() -> None:
    """These are stops by a car, a lorry and a motorcycle first. A kind that is not possible is replaced by a stop."""
    preference = preference_for(heavy=6.0)
    probes = [
        Commitments.start("any", np.random.default_rng(0), 6, preference=replace(preference, probe=k))
        for k in range(5)
    ]
    assert [memory.agenda.order for memory in probes[:4]] == [("hard-stop",)] * 3 + [("cut-in", "hard-stop")]
    assert [memory.stage.agent_class.name for memory in probes[:4]] == ["CAR", "TRUCK", "MOTORCYCLE", "CAR"]
    assert probes[4].agenda.order == ("crossing", "hard-stop")


def test_a_stop_is_no_probe_of_cut_ins() -> None:
    """Probe 1 is a stop by a lorry, probe 3 a cut-in by a car; a stop by a car is neither."""

    def met(kind: str, heavy: float) -> np.ndarray:
        features = np.zeros((1, COUNT))
        features[0, [FEATURES.index(kind), FEATURES.index("heavy")]] = 1.0, heavy
        return features

    stop, lorry, cut_in = met("hard-stop", 0.0), met("hard-stop", 1.0), met("cut-in", 0.0)
    assert [is_probed(1, features) for features in (stop, lorry, cut_in)] == [False, True, False]
    assert [is_probed(3, features) for features in (stop, lorry, cut_in)] == [False, False, True]
    assert not is_probed(3, np.concatenate((stop, met("cut-in", 1.0))))  # neither has both kind and class
    assert is_probed(3, np.concatenate((stop, cut_in)))
    assert not is_probed(0, np.zeros((0, COUNT)))


def test_the_kind_in_which_the_target_fails_has_most_turns() -> None:
    agendas = [memory.agenda for memory in starts(preference_for(cut_in=6.0))]
    first = Counter(agenda.order[0] for agenda in agendas)
    assert first["cut-in"] > 0.75 * EPISODES
    # the others remain, in case the kind is not possible
    assert all({"hard-stop", "cut-in", "crossing"} <= {*agenda.order} for agenda in agendas)
    # a crossing vehicle would prevent other encounters
    assert not any(agenda.crosses_any_time for agenda in agendas)
    assert all(memory.agenda.crosses_any_time for memory in starts(preference_for()))


def test_vehicles_come_from_where_the_target_does_not_see_them() -> None:
    assert np.mean([memory.stage.oncoming for memory in starts(preference_for(oncoming=6.0))]) > 0.9


def test_exploring_episodes_draw_without_predictions() -> None:
    plain, all_explore = starts(None), starts(preference_for(exploration_share=1.0, heavy=6.0))
    assert [(a.stage, a.agenda, a.weights) for a in all_explore] == [
        (a.stage, a.agenda, a.weights) for a in plain
    ]


def test_predictions_leave_the_draws_of_a_single_kind_unchanged() -> None:
    plain, known = starts(None, "cut-in"), starts(preference_for(heavy=6.0), "cut-in")
    assert [(a.stage, a.agenda) for a in known] == [(a.stage, a.agenda) for a in plain]


@pytest.mark.parametrize(
    ("attack", "heavy", "begins"), [("hard-stop", 0.0, True), ("hard-stop", 6.0, False), ("any", 0.0, False)]
)
def test_a_single_kind_begins_even_if_others_have_better_predictions(
    attack: str, heavy: float, begins: bool, motorway: RoadMap
) -> None:
    """A stop has a prediction of 5 %, a cut-in of 95 %. Any encounter must reach a fifth of the best: 19 %.

    Among stops alone the fifth is 1 %, unless a lorry has a better prediction.
    """
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 90.0, 20.0))
    kept = Commitments.start(
        attack, np.random.default_rng(0), preference=preference_for(cut_in=6.0, heavy=heavy)
    )
    assert kept.preference is not None
    ranked = rank(view, list(KINDS["hard-stop"](view, 1)), {"hard-stop": 1.0}, preference=kept.preference)
    assert any(not chosen.manoeuvre.is_positioning for chosen in ranked) == begins


def test_manoeuvres_are_ranked_by_predicted_failures(motorway: RoadMap) -> None:
    """A leader brakes so that 5 or 6 m/s² are required. More is better, unless the target fails where less is."""
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 90.0, 20.0))
    proposals = [m for m in KINDS["hard-stop"](view, 1) if not m.is_positioning]
    weights = {"hard-stop": 1.0}
    plain = rank(view, proposals, weights)
    assert len({chosen.needed_mps2 for chosen in plain}) > 1
    gentle = rank(view, proposals, weights, preference=preference_for(needed_braking=-20.0))
    assert gentle[0].needed_mps2 == min(chosen.needed_mps2 for chosen in plain)
    assert {chosen.merit for chosen in gentle} == {chosen.merit for chosen in plain}
    assert all(len(chosen.features) == COUNT for chosen in gentle)
    assert all(chosen.features == () for chosen in plain)


def test_a_manoeuvre_that_prevents_a_far_better_encounter_does_not_begin(motorway: RoadMap) -> None:
    """A stopping car has a prediction of 5 %, a lorry of 95 %: the car would prevent the better encounter."""
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 90.0, 20.0))
    proposals = list(KINDS["hard-stop"](view, 1))
    for preference, begins in (
        (preference_for(), True),
        (preference_for(heavy=6.0), False),
        (preference_for(1.0, heavy=6.0), True),
    ):
        explored = preference.draw(np.random.default_rng(0), {AgentClass.CAR: 1.0}, 1)[1]
        ranked = rank(view, proposals, {"hard-stop": 1.0}, preference=explored)
        assert any(not chosen.manoeuvre.is_positioning for chosen in ranked) == begins


def test_an_encounter_keeps_its_features(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 90.0, 20.0))
    begun = Commitments.start("hard-stop", np.random.default_rng(0), preference=preference_for())
    _, memory = update_manoeuvres(view, begun, 2, 8.0)
    assert len(memory.active["leader"].features) == COUNT
    _, plain = update_manoeuvres(view, replace(begun, preference=None), 2, 8.0)
    assert plain.active["leader"].features == ()
