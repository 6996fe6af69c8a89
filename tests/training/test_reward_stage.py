"""Rewards and values of Q, worked by hand on two cars on a straight road."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import pytest
import torch

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.training.adversarial_reward import Payoff, payoffs
from advdiff_sumo.training.experience import (
    Experience,
    decoded,
    from_logs,
    gathered,
    observed,
    pick_target,
    random_action,
    value_of,
)
from advdiff_sumo.training.guide_adaptation import WarmUp
from advdiff_sumo.training.presets import RewardOptions
from advdiff_sumo.training.reward_stage import RewardStage, best_value, q_loss

OPTIONS = RewardOptions(execute=2, returns=1, reach_m=2.0, vehicles=0.5, road=0.2)
WIDTH, LENGTH = 2.0, 4.0


def chance(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def cars(places: list[tuple[float, float]], speeds: list[float]) -> tuple[SceneBatch, Rollout]:
    """Return cars that look along x, and two steps of theirs at constant speed; no map."""
    number = len(places)
    now = torch.tensor([[x, y, 0.0, v] for (x, y), v in zip(places, speeds, strict=True)])[None]
    steps = torch.arange(1, 3)[None, None] * 0.5
    x = now[..., 0, None] + now[..., 3, None] * steps
    y = now[..., 1, None].expand_as(x)
    xy = torch.stack((x, y), dim=-1)
    flags = torch.ones(1, number, dtype=torch.bool)
    nothing = torch.zeros_like(x)
    batch = SceneBatch(
        past=now[:, :, None].repeat(1, 1, 5, 1),
        past_valid=flags[..., None].repeat(1, 1, 5),
        size=torch.tensor([LENGTH, WIDTH]).repeat(1, number, 1),
        classes=torch.zeros(1, number, dtype=torch.long),
        present=flags,
        moved=flags,
        parked=~flags,
        map_xy=torch.zeros(1, number, 40, 6, 2),
        map_features=torch.zeros(1, number, 40, 13),
        map_valid=torch.zeros(1, number, 40, dtype=torch.bool),
        future=torch.zeros(1, number, 12, 4),
        future_valid=flags[..., None].repeat(1, 1, 12),
    )
    return batch, Rollout(xy, nothing, now[..., 3, None].expand_as(x), nothing, nothing)


def one(batch: SceneBatch, path: Rollout, target: int = 0, options: RewardOptions = OPTIONS) -> Payoff:
    return payoffs(path, batch, torch.tensor([target]), options, 1)[0]


def test_being_near_is_worth_more_the_smaller_the_gap() -> None:
    batch, path = cars([(0.0, 0.0), (0.0, 5.0)], [10.0, 10.0])  # side by side, 3 m of air
    found = one(batch, path)
    assert float(found.reward) == pytest.approx(math.exp(-3.0 / 2.0), rel=1e-3)
    assert not found.contact


def test_contact_is_worth_one() -> None:
    batch, path = cars([(20.0, 0.0), (0.0, 0.0)], [0.0, 18.0])  # 18 m ahead: into it from behind
    found = one(batch, path)
    assert float(found.reward) == pytest.approx(1.0)
    assert found.contact


def test_cars_that_pass_through_each_other_between_two_instants_touch() -> None:
    batch, path = cars([(12.0, 0.0), (0.0, 0.0)], [0.0, 50.0])  # 25 m in half a second
    assert one(batch, path).contact


def test_a_parked_neighbour_is_no_attacker() -> None:
    batch, path = cars([(0.0, 0.0), (0.0, 3.0)], [0.0, 0.0])
    assert float(one(batch, path).reward) == pytest.approx(math.exp(-0.5), rel=1e-3)
    parked = replace(batch, parked=torch.tensor([[False, True]]))
    assert float(one(parked, path).reward) == pytest.approx(0.0, abs=1e-6)


def test_background_cars_that_hit_each_other_cost_but_not_the_target() -> None:
    places = [(500.0, 0.0), (0.0, 0.0), (20.0, 0.0)]
    batch, path = cars(places, [0.0, 20.0, 0.0])  # the second ends inside the third
    assert float(one(batch, path).reward) == pytest.approx(-0.5, abs=0.05)  # full overlap times its weight
    assert float(one(batch, path, target=2).reward) == pytest.approx(1.0, abs=1e-3)


def test_cars_that_overlap_before_anything_happens_cost_nothing() -> None:
    batch, path = cars([(500.0, 0.0), (0.0, 0.0), (1.0, 0.0)], [0.0, 0.0, 0.0])
    assert float(one(batch, path).reward) == pytest.approx(0.0, abs=1e-6)


def test_values_of_rewards_are_scaled_and_contact_is_for_ever() -> None:
    def payoff(reward: float, contact: bool) -> Payoff:
        return Payoff(torch.tensor([reward]), torch.tensor([contact]))

    gain, remains = value_of([payoff(0.5, False), payoff(0.2, False)], 0.9)
    assert float(gain) == pytest.approx(0.1 * 0.5 + 0.9 * 0.1 * 0.2)
    assert float(remains) == pytest.approx(0.81)
    gain, remains = value_of([payoff(0.5, False), payoff(1.0, True), payoff(0.7, False)], 0.9)
    assert float(gain) == pytest.approx(0.1 * 0.5 + 0.9 * 1.0)
    assert float(remains) == 0.0


def test_the_dqn_loss_is_the_squared_error_to_reward_and_best_candidate(
    bundle: Bundle, batch: SceneBatch
) -> None:
    made = next(iter(from_logs(bundle, batch, OPTIONS, chance())))
    with torch.no_grad():
        loss, _ = q_loss(bundle, bundle.reward, made, OPTIONS, chance(5))
        context, after = bundle.traffic.encoder(made.state), bundle.traffic.encoder(made.after)
        best = best_value(bundle, bundle.reward, made, after, OPTIONS.candidates, chance(5))
        q = bundle.reward(context.h, context.prior.mean, made.action, made.state, made.target)
    wanted = made.gain + made.remains * best
    assert float(loss) == pytest.approx(float((made.weight * (q - wanted) ** 2).sum()), rel=1e-5)
    few = best_value(bundle, bundle.reward, made, after, 1, chance(5))
    assert (best >= few).all()


def test_the_target_replays_its_log(bundle: Bundle, batch: SceneBatch) -> None:
    target, usable = pick_target(batch, 12, chance())
    assert usable.all()
    context = bundle.traffic.encoder(batch)
    path = decoded(bundle, random_action(bundle, context, OPTIONS, chance()), context, batch, target)
    row = torch.arange(batch.scenes)
    assert torch.equal(path.xy[row, target], batch.future[row, target, :, :2])
    others = batch.moved.clone()
    others[row, target] = False
    assert not torch.allclose(path.xy[others], batch.future[others][..., :2])


def test_targets_are_vehicles_with_a_future(batch: SceneBatch) -> None:
    for seed in range(20):
        target, usable = pick_target(batch, 12, chance(seed))
        row = torch.arange(batch.scenes)
        assert usable.all()
        assert not batch.parked[row, target].any()
    unknown = replace(batch, future_valid=torch.zeros_like(batch.future_valid))
    assert not pick_target(unknown, 12, chance())[1].any()


def test_experiences_follow_each_other(bundle: Bundle, batch: SceneBatch) -> None:
    options = RewardOptions(execute=2, returns=2, transitions=6)
    made = list(from_logs(bundle, batch, options, chance()))
    assert len(made) == 5  # the last one needs steps 9 … 12
    assert torch.equal(made[0].target, made[1].target)
    row = torch.arange(batch.scenes)
    moved = made[1].state.pose[row, made[0].target] - batch.future[row, made[0].target, 1]
    assert moved.abs().max() < 1e-4  # the target stands where its log was two steps later


def test_experiences_of_several_sizes_are_gathered(bundle: Bundle, batch: SceneBatch) -> None:
    made = next(iter(from_logs(bundle, batch, OPTIONS, chance())))
    small = Experience(
        **{f.name: _cut(getattr(made, f.name)) for f in fields(Experience)},
    )
    whole = gathered([small, made])
    assert whole.state.scenes == batch.scenes + 1
    assert whole.action.shape == (batch.scenes + 1, batch.agents, 8)
    with torch.no_grad():
        alone, _ = q_loss(bundle, bundle.reward, small, replace_candidates(), chance())
        both, _ = q_loss(bundle, bundle.reward, gathered([small, small]), replace_candidates(), chance())
    assert both.isfinite()
    assert alone.isfinite()


def replace_candidates() -> RewardOptions:
    return RewardOptions(candidates=1)


def _cut(value: SceneBatch | torch.Tensor) -> SceneBatch | torch.Tensor:
    return value.rows(slice(0, 1)) if isinstance(value, SceneBatch) else value[:1]


def test_warm_up_refits_q_alone(bundle: Bundle) -> None:
    batch, path = cars([(20.0, 0.0), (0.0, 0.0)], [0.0, 18.0])
    action = torch.randn(1, 2, 8, generator=chance())
    seen = observed(batch, path, torch.tensor([0]), action, OPTIONS)
    assert float(seen.gain) == pytest.approx(1.0)
    others = {name: value.clone() for name, value in bundle.tensors().items() if "reward." not in name}
    values = OPTIONS.model_copy(update={"direction": 0.0})
    found = WarmUp(bundle, values, learning_rate=3e-3).fit([seen], 60)
    assert found[-1] < 0.05 * found[0]
    assert all(torch.equal(value, bundle.tensors()[name]) for name, value in others.items())
    with pytest.raises(ValueError, match="no experience"):
        WarmUp(bundle, OPTIONS).fit([], 1)


def test_a_warm_up_takes_experiences_to_where_the_networks_are(bundle: Bundle) -> None:
    """Records are on the CPU, the networks of a policy may be elsewhere: "meta" refuses to mix as a GPU does."""
    batch, path = cars([(20.0, 0.0), (0.0, 0.0)], [0.0, 18.0])
    seen = observed(batch, path, torch.tensor([0]), torch.zeros(1, 2, 8), OPTIONS)
    values = OPTIONS.model_copy(update={"direction": 0.0})  # PyTorch has no torch.nonzero of "meta"
    assert WarmUp(bundle.to("meta"), values)._loss([seen, seen]).device.type == "meta"
    moved = seen.to("meta")
    parts = [getattr(moved, f.name) for f in fields(Experience)]
    parts += [*vars(moved.state).values(), *vars(moved.after).values()]
    assert {one.device.type for one in parts if isinstance(one, torch.Tensor)} == {"meta"}


def test_the_target_network_follows(bundle: Bundle) -> None:
    stage = RewardStage(bundle, RewardOptions(target_decay=0.75))
    mine, theirs = next(stage.beside.parameters()), next(bundle.reward.parameters())
    with torch.no_grad():
        mine.zero_()
        theirs.fill_(1.0)
    stage.after_step()
    assert torch.allclose(mine, torch.full_like(mine, 0.25))
