"""Guidance: lengths, masks and directions by hand; each kind of attack likes what it is named after."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from advdiff_sumo.diffusion.attack_costs import COSTS, SeenAttack, seen_attack
from advdiff_sumo.diffusion.bodies import AttackStates, attack_distances
from advdiff_sumo.diffusion.guides import FLOOR, Guidance, Term, direction
from advdiff_sumo.diffusion.sampler import SamplingStep
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.road_edges import RoadEdges

SIZE = torch.tensor([4.0, 2.0])


def test_the_direction_has_unit_length_and_only_attackers_move() -> None:
    """∇ ½ Σ (μ − 1)² at μ = 0 is −1 everywhere; two attackers of four numbers: each is −1 / √8."""
    attackers = torch.tensor([0.0, 1.0, 1.0])
    made = direction(lambda mu: 0.5 * (mu - 1.0).square().sum((1, 2)), torch.zeros(2, 3, 4), attackers)
    assert made[:, 0].abs().max() == 0.0
    torch.testing.assert_close(made[:, 1:], torch.full((2, 2, 4), -(8.0**-0.5)))


@pytest.mark.parametrize("factor", [0.0, float("nan"), float("inf")])
def test_no_gradient_and_no_number_are_no_direction(factor: float) -> None:
    made = direction(lambda mu: (factor * mu).sum((1, 2)), torch.ones(1, 2, 3), torch.ones(2))
    assert made.abs().max() == 0.0


@pytest.mark.parametrize(("deviation", "length"), [(0.8, 0.8), (0.0, FLOOR)])
def test_a_step_is_alpha_times_the_deviation_long(deviation: float, length: float) -> None:
    """One objective along the first number, one along the second, with weights 3 and 1: (3, 1) / 4 of α √Σ."""
    terms = (
        Term(lambda mu: mu[:, :, 0].sum(1), 3.0, 2),
        Term(lambda mu: 7.0 * mu[:, :, 1].sum(1), 1.0, 1),
    )
    guide = Guidance(terms, torch.tensor([1.0, 0.0]), 2.0)
    mean = torch.zeros(1, 2, 1, 2)
    last = guide(mean, SamplingStep(0, 1.0, deviation))
    torch.testing.assert_close(last[0, 0, 0], 2.0 * length * torch.tensor([0.75, 0.25]))
    assert last[0, 1].abs().max() == 0.0
    before = guide(mean, SamplingStep(1, 0.9, deviation))
    torch.testing.assert_close(before[0, 0, 0], 2.0 * length * torch.tensor([0.75, 0.0]))
    assert guide(mean, SamplingStep(2, 0.5, deviation)).abs().max() == 0.0


def test_latents_are_shown_without_the_share_of_noise() -> None:
    """μ = √α z⁰ + noise: the objectives see μ / √α."""
    seen: list[Tensor] = []

    def look(mu: Tensor) -> Tensor:
        seen.append(mu.detach())
        return mu.sum((1, 2))

    Guidance((Term(look, 1.0, 9),), torch.ones(1), 1.0)(torch.ones(1, 1, 1, 2), SamplingStep(3, 0.25, 0.5))
    torch.testing.assert_close(seen[0], torch.full((1, 1, 2), 2.0))


def test_the_last_step_turns_with_the_gradient() -> None:
    """Towards (0, 0) of −|μ|²/2 from (3, 4) with length 4 in two turns of 2: straight to it, μ = (0.6, 0.8).

    A second objective with gradient along y only where μ₁ < 2 is felt in the second turn alone.
    """
    centre = Term(lambda mu: -0.5 * mu.square().sum((1, 2)), 1.0, 1)
    start = torch.tensor([[[[3.0, 4.0]]]])
    made = Guidance((centre,), torch.ones(1), 4.0, turns=2)(start, SamplingStep(0, 1.0, 1.0))
    torch.testing.assert_close(made, torch.tensor([[[[-2.4, -3.2]]]]))
    late = Term(lambda mu: torch.where(mu[:, :, 0] < 2.0, mu[:, :, 1], -mu[:, :, 0]).sum(1), 1.0, 1)
    made = Guidance((late,), torch.ones(1), 4.0, turns=2)(start, SamplingStep(0, 1.0, 1.0))
    torch.testing.assert_close(made, torch.tensor([[[[-2.0, 2.0]]]]))  # −x first, then +y


def test_a_shift_begins_where_the_last_one_ended_and_has_a_longest() -> None:
    """Length 1 a plan along x, from (0, 1.5) for the attacker: (1, 1.5) is 1.80 long; from (0, 3) it is cut to 2."""
    along = Term(lambda mu: mu[:, :, 0].sum(1), 1.0, 1)
    mean, mask = torch.zeros(1, 2, 1, 2), torch.tensor([1.0, 0.0])
    guide = Guidance((along,), mask, 1.0, begin=torch.tensor([[0.0, 1.5], [0.0, 9.0]]))
    made = guide(mean, SamplingStep(0, 1.0, 1.0))
    torch.testing.assert_close(made[:, :, 0], torch.tensor([[[1.0, 1.5], [0.0, 0.0]]]))
    torch.testing.assert_close(guide.last_shift, made[:, :, 0])
    made = Guidance((along,), mask, 1.0, begin=torch.tensor([[0.0, 3.0], [0.0, 0.0]]))(
        mean, SamplingStep(0, 1.0, 1.0)
    )
    assert float(made.norm()) == pytest.approx(2.0)
    torch.testing.assert_close(made[0, 0, 0] / 2.0, torch.tensor([1.0, 3.0]) / 10.0**0.5)


def test_earlier_steps_are_made_in_one() -> None:
    asked = []

    def look(mu: Tensor) -> Tensor:
        asked.append(mu)
        return mu.sum((1, 2))

    guide = Guidance((Term(look, 1.0, 9),), torch.ones(1), 1.0, turns=3)
    guide(torch.ones(1, 1, 1, 2), SamplingStep(2, 0.5, 0.5))
    assert len(asked) == 1


# --- attacks ---------------------------------------------------------------------------------------------


def straight(x: float, y: float, yaw: float, speed: float, steps: int = 8) -> Rollout:
    """Return one vehicle that goes straight on, (1, 1, T)."""
    time = 0.5 * torch.arange(1, steps + 1, dtype=torch.float64)
    angle = torch.tensor(yaw, dtype=torch.float64)
    xy = torch.tensor([x, y], dtype=torch.float64) + (speed * time)[:, None] * torch.stack(
        (torch.cos(angle), torch.sin(angle))
    )
    same = torch.ones_like(time)
    return Rollout(*(part[None, None] for part in (xy, yaw * same, speed * same, 0.0 * same, 0.0 * same)))


def met(attacker: Rollout) -> SeenAttack:
    """Return the encounter with a target that drives north at 10 m/s from (5, 0)."""
    return between(attacker, straight(5.0, 0.0, torch.pi / 2, 10.0))


def between(attacker: Rollout, target: Rollout) -> SeenAttack:
    """Return the encounter of two vehicles far from any road's edge."""
    size = SIZE.double().expand(2, 2)
    nowhere = torch.zeros(1, 1, 1, 2, dtype=torch.float64)
    edges = RoadEdges.between(nowhere, nowhere, torch.zeros(1, 1, 1, dtype=torch.bool))
    states = (torch.cat((a[0], b[0])) for a, b in zip(_motion(target), _motion(attacker), strict=True))
    pose, moved = torch.zeros(1, 4, dtype=torch.float64), torch.ones(1, dtype=torch.bool)
    placed = AttackStates(size, torch.zeros(2, dtype=torch.bool), *states, size[:1], pose, moved, edges)
    return seen_attack(attacker, attack_distances(attacker, placed).gap, placed)


def _motion(rollout: Rollout) -> tuple[Tensor, Tensor, Tensor]:
    return rollout.xy, rollout.yaw, rollout.speed


def test_an_encounter_by_hand() -> None:
    """12 m ahead, 3 m to the left, the same way at 8 m/s: after 1 s it is 10 m ahead, bodies 4.6 m apart.

    Discs of radius 1 m, two metres apart along each body: the foremost of one and the rearmost of the other are
    √((10 − 2)² ...) apart: 10 − 1 − 1 = 8 m along and 3 m across, less two radii.
    """
    e = met(straight(2.0, 12.0, torch.pi / 2, 8.0))
    assert e.ahead[0, 0].tolist() == pytest.approx([11, 10, 9, 8, 7, 6, 5, 4])
    assert e.left[0, 0].tolist() == pytest.approx([3.0] * 8)
    assert e.same[0, 0].tolist() == pytest.approx([1.0] * 8)
    assert float(e.gap[0, 0, 1]) == pytest.approx((8.0**2 + 3.0**2) ** 0.5 - 2.0, abs=1e-6)
    assert e.reach.tolist() == [[4.0]]
    assert e.time_s.tolist() == [0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0]


NORTH, SOUTH, WEST = torch.pi / 2, -torch.pi / 2, torch.pi


@pytest.mark.parametrize(
    ("kind", "better", "worse"),
    [
        ("any", straight(5.0, 20.0, NORTH, 6.0), straight(5.0, 40.0, NORTH, 12.0)),
        ("cut-in", straight(5.0, 12.0, NORTH, 8.0), straight(8.5, 12.0, NORTH, 8.0)),
        ("cut-in", straight(5.0, 12.0, NORTH, 8.0), straight(5.0, 12.0, NORTH, 14.0)),
        ("cut-in", straight(5.0, 12.0, NORTH, 8.0), straight(5.0, -12.0, NORTH, 8.0)),
        ("brake", straight(5.0, 20.0, NORTH, 3.0), straight(5.0, 20.0, NORTH, 10.0)),
        ("rear-end", straight(5.0, -12.0, NORTH, 14.0), straight(5.0, -12.0, NORTH, 8.0)),
        ("rear-end", straight(5.0, -12.0, NORTH, 14.0), straight(8.5, -12.0, NORTH, 14.0)),
        ("head-on", straight(5.0, 60.0, SOUTH, 8.0), straight(1.5, 60.0, SOUTH, 8.0)),
        ("head-on", straight(5.0, 60.0, SOUTH, 8.0), straight(5.0, 30.0, NORTH, 8.0)),
        ("junction", straight(25.0, 20.0, WEST, 10.0), straight(25.0, 20.0, WEST, 4.0)),
    ],
)
def test_each_kind_costs_less_where_it_does_what_it_says(kind: str, better: Rollout, worse: Rollout) -> None:
    assert float(COSTS[kind](met(better))) < float(COSTS[kind](met(worse))) - 0.05


@pytest.mark.parametrize("kind", sorted(COSTS))
def test_costs_do_not_depend_on_the_worlds_frame(kind: str) -> None:
    def turned(r: Rollout) -> Rollout:
        angle = torch.tensor(1.1, dtype=torch.float64)
        cos, sin = torch.cos(angle), torch.sin(angle)
        x, y = r.xy[..., 0], r.xy[..., 1]
        xy = torch.stack((cos * x - sin * y + 30.0, sin * x + cos * y - 9.0), dim=-1)
        return Rollout(xy, r.yaw + angle, r.speed, r.accel, r.curvature)

    attacker, target = straight(8.0, 14.0, 1.9, 7.0), straight(5.0, 0.0, NORTH, 10.0)
    changes = (lambda r: r, turned)
    costs = [float(COSTS[kind](between(change(attacker), change(target)))) for change in changes]
    assert costs[0] == pytest.approx(costs[1], abs=1e-9)
