"""Strive's loss, worked by hand, and its search on a street."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from advdiff_sumo.core.plan import Plan
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.view import look
from advdiff_sumo.planners.lane_graph import LaneGraphPlanner
from advdiff_sumo.traffic.baselines.baseline_options import StriveOptions
from advdiff_sumo.traffic.baselines.baseline_policy import SearchTask, halves
from advdiff_sumo.traffic.baselines.strive import Strive
from advdiff_sumo.traffic.baselines.strive_loss import adversarial_term, strive_loss

Street = Callable[..., Scene]
PLACES = [(60.0, 0.0), (78.0, 0.0), (42.0, 0.0), (95.0, 0.0)]
SPEEDS = [8.0, 7.0, 9.0, 6.0]


def standing(*x: float) -> Rollout:
    """Return two instants of vehicles that stand at positions *x* on a line."""
    xy = torch.tensor([[place, 0.0] for place in x])[None, :, None].repeat(1, 1, 2, 1)
    zero = torch.zeros(xy.shape[:3])
    return Rollout(xy, zero, zero, zero, zero)


def test_the_softmin_by_hand() -> None:
    """Distances 3 and 5 at both instants: δ is a softmin over all four."""
    loss, share = adversarial_term(standing(0.0, 3.0, -5.0), torch.tensor([False, True, True]))
    near = np.exp(-3.0) / (2.0 * (np.exp(-3.0) + np.exp(-5.0)))
    assert share.tolist() == pytest.approx([0.0, 2.0 * near, 1.0 - 2.0 * near], abs=1e-5)
    assert float(loss) == pytest.approx(2.0 * near * 9.0 + (1.0 - 2.0 * near) * 25.0, rel=1e-5)


def test_vehicles_that_are_not_moved_are_no_attackers() -> None:
    loss, share = adversarial_term(standing(0.0, 3.0, -5.0), torch.tensor([False, False, True]))
    assert share.tolist() == [0.0, 0.0, 1.0]
    assert float(loss) == pytest.approx(25.0)


def test_midpoints_are_inserted() -> None:
    rollout = standing(4.0)
    pose = torch.tensor([[[0.0, 0.0, 0.0, 0.0]]])
    assert halves(rollout, pose).xy[0, 0, :, 0].tolist() == [2.0, 4.0, 4.0, 4.0]


def test_the_prior_counts_less_for_attackers(downtown: RoadMap, street: Street) -> None:
    """The nearest vehicle has all of the share: its latent is nearly free, the other's is not."""
    scene = street([(60.0, 0.0), (70.0, 0.0), (110.0, 0.0)], [0.0, 0.0, 0.0])
    batch = look(downtown, scene).batch
    states = batch.pose[:, :, None].repeat(1, 1, 2, 1)
    zero = torch.zeros(states.shape[:3])
    rollout = Rollout(states[..., :2], states[..., 2], states[..., 3], zero, zero)
    moved, options = torch.tensor([False, True, True]), StriveOptions()

    def at(row: int) -> tuple[float, float]:
        epsilon = torch.zeros(3, 4)
        epsilon[row, 0] = 2.0
        terms = strive_loss(rollout, batch, moved, moved, (epsilon, torch.zeros(3, 4)), options)
        return float(terms.prior), float(terms.start)

    assert at(1) == pytest.approx((0.5 * 4.0 * 0.005 / 2.0, 4.0 * 0.05), rel=1e-3)
    assert at(2) == pytest.approx((0.5 * 4.0 * 1.0 / 2.0, 4.0 * 0.5), rel=1e-3)


def test_vehicles_that_may_not_attack_keep_to_the_prior_at_any_distance(
    downtown: RoadMap, street: Street
) -> None:
    """The nearer vehicle, 10 m away, may not attack: the other one, 50 m away, has all of the share."""
    batch = look(downtown, street([(60.0, 0.0), (70.0, 0.0), (110.0, 0.0)], [0.0] * 3)).batch
    states = batch.pose[:, :, None].repeat(1, 1, 2, 1)
    zero = torch.zeros(states.shape[:3])
    rollout = Rollout(states[..., :2], states[..., 2], states[..., 3], zero, zero)
    moved, may, epsilon = (
        torch.tensor([False, True, True]),
        torch.tensor([False, False, True]),
        torch.zeros(3, 4),
    )
    epsilon[1, 0] = 2.0
    terms = strive_loss(rollout, batch, moved, may, (epsilon, torch.zeros(3, 4)), StriveOptions())
    assert terms.share.tolist() == pytest.approx([0.0, 0.0, 1.0])
    assert float(terms.adversarial) == pytest.approx(2500.0, rel=1e-3)
    assert (float(terms.prior), float(terms.start)) == pytest.approx((0.5 * 4.0 / 2.0, 4.0 * 0.5), rel=1e-3)


def test_collision_terms_by_hand(downtown: RoadMap, street: Street) -> None:
    """Two vehicles that overlap fully count 1; the attacker's own contact with the target counts 0."""
    scene = street([(60.0, 0.0), (61.0, 0.0), (90.0, 0.0), (90.0, 0.0)], [0.0] * 4)
    batch = look(downtown, scene).batch
    states = batch.pose[:, :, None].repeat(1, 1, 2, 1)
    zero = torch.zeros(states.shape[:3])
    rollout = Rollout(states[..., :2], states[..., 2], states[..., 3], zero, zero)
    none = torch.zeros(4, 4)
    moved = torch.tensor([False, True, True, True])
    terms = strive_loss(rollout, batch, moved, moved, (none, none), StriveOptions())
    assert float(terms.vehicles) == pytest.approx(1.0, abs=1e-3)
    assert float(terms.target) == pytest.approx(0.0, abs=1e-6)
    assert float(terms.total) == pytest.approx(
        2.0 * float(terms.adversarial) + 20.0 * float(terms.vehicles + terms.road), rel=1e-5
    )


@pytest.mark.parametrize("surrogate", ["model", "lane_graph"])
def test_the_search_lowers_the_loss(surrogate: str, weights: str, downtown: RoadMap, street: Street) -> None:
    """Against the same reaction of the surrogate the adversarial term is lower than at the start."""
    scene = street(PLACES, SPEEDS)
    policy = Strive(weights=weights, rounds=12, refresh=12, surrogate=surrogate, licence="reckless")
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    task = SearchTask(downtown, look(downtown, scene), memory, 1)
    found = policy.search(task)
    assert found.losses[-1] < found.losses[0]
    start = policy._start(task)
    with torch.no_grad():
        forced = policy.react(task, policy.ask(task), policy._decode(start, start.warm_start, None))
        moved = found.memory.searched
        epsilon = torch.from_numpy(np.stack([moved[name] for name in task.view.ids])).float()
        before, after = (policy.loss(start, e, forced) for e in (start.natural, epsilon))
    assert float(after.total) < float(before.total)
    assert float(after.adversarial) < float(before.adversarial)


def test_the_target_drives_the_surrogates_states(weights: str, downtown: RoadMap, street: Street) -> None:
    """For 4 s; and the loss is the same whether the road's edges are given or derived."""
    scene = street(PLACES, SPEEDS)
    policy = Strive(weights=weights, licence="reckless")
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    task = SearchTask(downtown, look(downtown, scene), memory, 1)
    start = policy._start(task)
    with torch.no_grad():
        forced = policy.react(task, policy.ask(task), policy._decode(start, start.warm_start, None))
        assert forced is not None
        epsilon = start.warm_start + 0.5
        rollout = policy._decode(start, epsilon, forced, 8)
        assert torch.equal(rollout.states()[0, 0], forced.states[0, 0, :8])
        given = rollout, start.batch, start.moved, start.may_attack, (epsilon, start.natural), policy.options
        assert torch.equal(strive_loss(*given).total, policy.loss(start, epsilon, forced).total)


def test_latents_of_vehicles_that_are_not_moved_are_unchanged(
    weights: str, downtown: RoadMap, street: Street
) -> None:
    scene = street(PLACES, SPEEDS)
    scene = Scene(scene.history, 0, np.array([False, True, False, True]), scene.routes, scene.signals)
    policy = Strive(weights=weights, rounds=3, licence="reckless")
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    found = policy.search(SearchTask(downtown, look(downtown, scene), memory, 1)).memory.searched
    assert {name for name, value in found.items() if value.any()} == {"v1", "v3"}


def test_the_next_search_starts_from_the_previous_result(
    weights: str, downtown: RoadMap, street: Street
) -> None:
    scene = street(PLACES, SPEEDS)
    policy = Strive(weights=weights, rounds=3, persistence=0.5, licence="reckless")
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    view = look(downtown, scene)
    first = policy.search(SearchTask(downtown, view, memory, 1)).memory
    begun = policy._start(SearchTask(downtown, view, first, 2))
    wanted = np.stack([0.5 * first.searched[name] for name in view.ids])
    np.testing.assert_allclose(begun.warm_start.numpy(), wanted, atol=1e-6)
    assert not begun.natural.any()


def test_temperature_1_draws_from_the_prior(weights: str, downtown: RoadMap, street: Street) -> None:
    """Without rounds, temperature 1 gives the traffic model's draws; persistence keeps them."""
    scene = street(PLACES, SPEEDS)
    policy = Strive(weights=weights, rounds=0, temperature=1.0, persistence=1.0)
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    view = look(downtown, scene)
    one, other = (policy.search(SearchTask(downtown, view, memory, seed)) for seed in (1, 2))
    assert not torch.equal(one.drawn.rollout.xy, other.drawn.rollout.xy)
    kept = policy.search(SearchTask(downtown, view, one.memory, 3))
    assert torch.equal(kept.drawn.rollout.xy, one.drawn.rollout.xy)


def test_vehicles_behind_the_target_attack_only_if_reckless(
    weights: str, downtown: RoadMap, street: Street
) -> None:
    """Two are behind the target; the last one, ahead on its left, may attack under every licence."""
    scene = street([(60.0, 0.0), (48.0, 0.0), (46.0, 4.0), (70.0, 6.0)], [8.0] * 4)
    found = {}
    for licence in ("reckless", "careless", "lawful"):
        policy = Strive(weights=weights, rounds=3, attackers=8, licence=licence)
        memory = policy.start(downtown, scene, None, np.random.default_rng(0))
        found[licence] = policy.search(SearchTask(downtown, look(downtown, scene), memory, 1)).drawn.attackers
    assert set(found["reckless"]) == {"v1", "v2", "v3"}
    assert found["careless"] == found["lawful"] == ("v3",)


class Counts(LaneGraphPlanner):
    """A surrogate whose memory counts its plans."""

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> int:
        return 0

    def plan(self, road: RoadMap, scene: Scene, memory: int, rng: np.random.Generator) -> tuple[Plan, int]:
        return super().plan(road, scene, super().start(road, scene, rng), rng)[0], memory + 1


def test_traffic_is_natural_without_possible_attackers(
    weights: str, downtown: RoadMap, street: Street
) -> None:
    """The result of an earlier search is dropped; the surrogate still plans in every scene."""
    scene = street([(60.0, 0.0), (48.0, 0.0), (46.0, 4.0)], [8.0] * 3)
    policy = Strive(weights=weights, surrogate=f"{__name__}:Counts")
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    view = look(downtown, scene)
    searched = {name: np.ones(8) for name in view.ids}
    memory = replace(memory, searched=searched, natural={name: np.zeros(8) for name in view.ids})
    found = policy.search(SearchTask(downtown, view, memory, 1))
    calm = Strive(weights=weights, rounds=0).search(SearchTask(downtown, view, memory, 1))
    assert torch.equal(found.drawn.rollout.states(), calm.drawn.rollout.states())
    assert (found.drawn.attackers, found.losses) == ((), ())
    assert (memory.surrogate, found.memory.surrogate) == (0, 1)
