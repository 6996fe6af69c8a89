"""Where Q points: what attackers want, worked by hand, who counts, and that it can be learnt."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.training.experience import Experience, from_logs
from advdiff_sumo.training.gradient_alignment import agreement_of, approach, direction_loss
from advdiff_sumo.training.guide_adaptation import WarmUp
from advdiff_sumo.training.presets import RewardOptions
from tests.training.test_reward_stage import cars, chance

OPTIONS = RewardOptions(execute=2, returns=1, transitions=1)
STILL = OPTIONS.model_copy(update={"push": 0.0})


@pytest.fixture
def made(bundle: Bundle, batch: SceneBatch) -> Experience:
    return next(iter(from_logs(bundle, batch, OPTIONS, chance())))


def test_the_least_gap_is_what_attackers_want_small() -> None:
    batch, path = cars([(0.0, 0.0), (0.0, 5.0)], [10.0, 10.0])  # side by side, 3 m of air at both instants
    cost, near = approach(path, batch, torch.tensor([0]))
    assert float(cost) == pytest.approx(3.0 - math.log(2.0), abs=1e-3)
    assert near.tolist() == [[False, True]]


def test_nearer_than_contact_is_no_better() -> None:
    batch, path = cars([(0.0, 0.0), (0.0, 1.0)], [10.0, 10.0])
    deeper, inside = cars([(0.0, 0.0), (0.0, 0.5)], [10.0, 10.0])
    target = torch.tensor([0])
    assert float(approach(path, batch, target)[0]) == float(approach(inside, deeper, target)[0])


def test_who_stays_far_does_not_count() -> None:
    batch, path = cars([(0.0, 0.0), (0.0, 60.0)], [10.0, 10.0])
    cost, near = approach(path, batch, torch.tensor([0]))
    assert float(cost) == 0.0
    assert not near.any()


def test_hitting_somebody_else_costs() -> None:
    places = [(0.0, 0.0), (0.0, 5.0), (20.0, 5.0)]
    batch, free = cars(places, [0.0, 0.0, 0.0])
    _, into = cars(places, [0.0, 20.0, 0.0])  # within a second the second is where the third stands
    target = torch.tensor([0])
    lone, touched = (float(approach(path, batch, target)[0]) for path in (free, into))
    assert touched > lone + 5.0


def test_a_q_that_ignores_actions_points_nowhere(bundle: Bundle, made: Experience) -> None:
    bundle.reward.action.weight.data.zero_()
    found = agreement_of(bundle, made, OPTIONS, chance())
    assert found.counts.any()
    assert not found.cosine.any()
    assert float(direction_loss(bundle, made, OPTIONS, chance()).detach()) == 1.0


def test_the_other_way_is_the_opposite(bundle: Bundle, made: Experience) -> None:
    there = agreement_of(bundle, made, STILL, chance()).cosine.detach()
    last = bundle.reward.value[2]
    last.weight.data.neg_()
    back = agreement_of(bundle, made, STILL, chance()).cosine.detach()
    assert there.abs().max() > 1e-3
    assert there.abs().max() <= 1.0 + 1e-6
    assert torch.allclose(back, -there, atol=1e-6)


def test_a_target_whose_drive_is_unknown_teaches_nothing(bundle: Bundle, made: Experience) -> None:
    known = torch.zeros_like(made.state.future_valid)
    unknown = replace(made, state=replace(made.state, future_valid=known))
    assert not agreement_of(bundle, unknown, OPTIONS, chance()).counts.any()
    nothing = replace(made, weight=torch.zeros_like(made.weight))
    assert not agreement_of(bundle, nothing, OPTIONS, chance()).counts.any()


def test_the_target_itself_never_counts(bundle: Bundle, made: Experience) -> None:
    counts = agreement_of(bundle, made, OPTIONS, chance()).counts
    assert not counts[torch.arange(len(made.target)), made.target].any()


def test_the_way_is_learnt(bundle: Bundle, made: Experience) -> None:
    """One experience by heart, without shifts."""
    bundle.traffic.requires_grad_(False)
    optimiser = torch.optim.Adam(bundle.reward.parameters(), 1e-2)
    for _ in range(150):
        optimiser.zero_grad()
        loss = direction_loss(bundle, made, STILL, chance())
        loss.backward()
        optimiser.step()
    assert float(loss.detach()) < 0.5  # 1: what a Q without a direction has


def test_a_warm_up_learns_the_way_as_well(bundle: Bundle, made: Experience) -> None:
    before = float(direction_loss(bundle, made, STILL, chance()).detach())
    options = STILL.model_copy(update={"direction": 1.0})
    WarmUp(bundle, options, learning_rate=1e-2).fit([made], 60)
    assert float(direction_loss(bundle, made, STILL, chance()).detach()) < before - 0.2
