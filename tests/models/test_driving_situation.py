"""Lights, vehicles ahead and limits, worked by hand, and what the denoiser makes of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import cast

import pytest
import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.collate import collate
from advdiff_sumo.models.context import ContextEncoder
from advdiff_sumo.models.denoiser import Denoiser
from advdiff_sumo.models.driving_situation import SITUATION_FEATURES, situation_features
from advdiff_sumo.models.model_options import PIECE_FEATURES, PIECE_POINTS, ModelOptions
from tests.models.conftest import WindowMaker

RED, YELLOW, GREEN = 0, 1, 2
LENGTH_M, WIDTH_M, LIMIT_MPS = 4.6, 2.0, 14.0


def lane(
    x_m: float, y_m: float = 0.0, turn_rad: float = 0.0, light: int | None = None
) -> tuple[Tensor, Tensor]:
    """Return a lane piece of 20 m that begins at *x_m*, *y_m*: points (N, 2) and columns (F,)."""
    along = torch.linspace(0.0, 20.0, PIECE_POINTS)
    points = torch.stack((x_m + along * math.cos(turn_rad), y_m + along * math.sin(turn_rad)), dim=-1)
    columns = torch.zeros(PIECE_FEATURES)
    columns[:3] = torch.tensor([3.5, LIMIT_MPS, 1.0])
    if light is not None:
        columns[PIECE_FEATURES - 3 + light] = 1.0
    return points, columns


def street(poses: list[tuple[float, float, float, float]], *pieces: tuple[Tensor, Tensor]) -> SceneBatch:
    """Return agents at (x, y, yaw, speed), all of whom see *pieces* as if those were in their own frame."""
    agents = len(poses)
    there = torch.ones(1, agents, dtype=torch.bool)
    xy, columns = (
        torch.stack(part)[None, None].expand(1, agents, *([-1] * 2), *([-1] * k)).clone()
        for part, k in zip(zip(*pieces, strict=True), (1, 0), strict=True)
    )
    return SceneBatch(
        past=torch.tensor(poses)[None, :, None].expand(1, agents, 5, 4).clone(),
        past_valid=there[..., None].expand(1, agents, 5).clone(),
        size=torch.tensor([LENGTH_M, WIDTH_M]).expand(1, agents, 2).clone(),
        classes=torch.zeros(1, agents, dtype=torch.long),
        present=there,
        moved=there.clone(),
        parked=~there,
        map_xy=xy,
        map_features=columns,
        map_valid=torch.ones(1, agents, len(pieces), dtype=torch.bool),
        future=torch.zeros(1, agents, 12, 4),
        future_valid=torch.zeros(1, agents, 12, dtype=torch.bool),
    )


STILL = (0.0, 0.0, 0.0, 0.0)


def lights(*pieces: tuple[Tensor, Tensor]) -> list[float]:
    return situation_features(street([STILL], *pieces))[0, 0, :3].tolist()


@pytest.mark.parametrize("colour", [RED, YELLOW, GREEN])
def test_the_light_straight_ahead_counts_by_the_way_to_its_line(colour: int) -> None:
    ahead = lights(lane(-20.0), lane(6.0 + 0.5 * LENGTH_M, light=colour))
    wanted = [0.0, 0.0, 0.0]
    wanted[colour] = math.exp(-6.0 / 15.0)
    assert ahead == pytest.approx(wanted, abs=1e-6)


def test_lights_of_other_lanes_and_those_passed_do_not_count() -> None:
    beside = lane(8.0, 3.5, light=RED)
    crossing = lane(8.0, 0.0, 0.5 * math.pi, light=RED)
    passed = lane(0.5 * LENGTH_M - 4.0, light=RED)
    assert lights(beside, crossing, passed) == [0.0, 0.0, 0.0]
    just_over = lights(lane(0.5 * LENGTH_M - 2.0, light=GREEN))
    assert just_over == [0.0, 0.0, 1.0]


def leader(*others: tuple[float, float, float, float], own_mps: float = 0.0) -> list[float]:
    return situation_features(street([(0.0, 0.0, 0.0, own_mps), *others], lane(-10.0)))[0, 0, 3:8].tolist()


def test_the_nearest_body_ahead() -> None:
    far = math.exp(-6.0 / 15.0)
    standing = leader((6.0 + LENGTH_M, 0.5, 0.0, 0.0), (40.0, 0.0, 0.0, 9.0))
    assert standing == pytest.approx([math.exp(-2.0), far, 0.0, far, 0.0], abs=1e-6)
    driving = leader((6.0 + LENGTH_M, 0.5, 0.0, 5.0), own_mps=8.0)
    assert driving == pytest.approx([math.exp(-2.0), far, 0.5 * far, 0.0, 0.3 * far], abs=1e-6)


def test_who_is_beside_or_behind_is_not_ahead() -> None:
    assert leader((8.0, 2.5, 0.0, 0.0), (-8.0, 0.0, 0.0, 9.0)) == [0.0] * 5
    assert leader() == [0.0] * 5


def test_the_limit_of_the_own_lane_and_the_own_speed_off_the_lanes() -> None:
    on = situation_features(street([(0.0, 0.0, 0.0, 9.0)], lane(-10.0, 0.5)))[0, 0, 8:].tolist()
    assert on == pytest.approx([1.4, 0.5, 0.9])
    off = situation_features(street([(0.0, 0.0, 0.0, 9.0)], lane(-10.0, 9.0)))[0, 0, 8:].tolist()
    assert off == pytest.approx([0.9, 0.0, 0.9])


def test_it_is_the_same_whatever_the_worlds_frame_and_finite(windows: WindowMaker) -> None:
    before = situation_features(collate(windows(), [0, 1]))
    after = situation_features(collate(windows(turn=1.1, shift=(300.0, -80.0)), [0, 1]))
    assert before.shape[-1] == SITUATION_FEATURES
    assert torch.isfinite(before).all()
    torch.testing.assert_close(before, after, atol=2e-4, rtol=1e-3)


def test_a_denoiser_begins_without_it_and_can_use_it(
    options: ModelOptions, windows: WindowMaker, lively: Callable[[nn.Module], nn.Module]
) -> None:
    told = options.model_copy(update={"denoiser_situation": True})
    context = ContextEncoder(told)(collate(windows(), [0, 1]))
    knowing = Denoiser(told, (1, options.latent))
    assert torch.equal(knowing.prepare(context).h, context.h)
    assert Denoiser(options, (1, options.latent)).prepare(context).h is context.h
    assert not torch.equal(cast(Denoiser, lively(knowing)).prepare(context).h, context.h)
