"""A scene some steps later: history, future and map as a fresh look at the world would give them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from advdiff_sumo.data.window_files import WindowFile
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.collate import collate
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import into_frame, rotate


def wander(batch: SceneBatch) -> Rollout:
    """Return some joint future of *batch*."""
    draw = torch.randn(batch.scenes, batch.agents, 12, 4, generator=torch.Generator().manual_seed(0))
    states = batch.pose[:, :, None] + torch.cumsum(draw, dim=2)
    still = torch.zeros_like(states[..., 0])
    return Rollout(states[..., :2], states[..., 2], states[..., 3], still, still)


@pytest.mark.parametrize("steps", [1, 3, 5, 7, 12])
def test_history_and_future_are_shifted(batch: SceneBatch, steps: int) -> None:
    rollout = wander(batch)
    later = batch.advanced(rollout.states()[:, :, :steps])
    states = torch.cat((batch.past, rollout.states()[:, :, :steps]), dim=2)
    assert later.past.shape == batch.past.shape
    torch.testing.assert_close(later.past, states[:, :, -5:])
    kept = max(5 - steps, 0)
    assert torch.equal(later.past_valid[:, :, :kept], batch.past_valid[:, :, 5 - kept :])
    assert torch.equal(later.past_valid[:, :, kept:].all(-1), batch.present)
    assert torch.equal(later.future[:, :, : 12 - steps], batch.future[:, :, steps:])
    assert torch.equal(later.future_valid[:, :, : 12 - steps], batch.future_valid[:, :, steps:])
    assert not bool(later.future[:, :, 12 - steps :].any())
    assert not bool(later.future_valid[:, :, 12 - steps :].any())
    for name in ("size", "classes", "present", "moved", "parked", "map_features", "map_valid"):
        assert torch.equal(getattr(later, name), getattr(batch, name)), name


@pytest.mark.parametrize("steps", [1, 4])
def test_the_map_is_seen_from_the_new_frames(batch: SceneBatch, steps: int) -> None:
    later = batch.advanced(wander(batch).states()[:, :, :steps])
    shape = batch.map_xy.shape[:-1]

    def world(scene: SceneBatch) -> torch.Tensor:
        pose = scene.pose[:, :, None, None]
        return pose[..., :2] + rotate(scene.map_xy, pose[..., 2].expand(shape))

    real = batch.map_valid
    torch.testing.assert_close(world(later)[real], world(batch)[real], atol=1e-4, rtol=0.0)
    pose = later.pose[:, :, None, None]
    seen = into_frame(world(batch), pose[..., :2], pose[..., 2].expand(shape))
    torch.testing.assert_close(later.map_xy[real], seen[real], atol=1e-4, rtol=0.0)


def test_by_hand(driving: Callable[..., SceneBatch]) -> None:
    """A car that looks east drives 5 m and turns north; the edge 4 m on its right is behind it then."""
    scene = driving([(0.0, 0.0, 0.0, 10.0)], edges=[[(float(x), -4.0) for x in range(6)]])
    place = torch.tensor([5.0, 0.0]).double().expand(1, 1, 1, 2)
    north, speed = torch.full((1, 1, 1), math.pi / 2).double(), torch.full((1, 1, 1), 6.0).double()
    later = scene.advanced(Rollout(place, north, speed, speed, north).states()[:, :, :1])
    wanted = torch.tensor([[-4.0, 5.0 - x] for x in range(6)]).double()
    torch.testing.assert_close(later.map_xy[0, 0, 0], wanted, atol=1e-6, rtol=0.0)
    wanted = torch.tensor([5.0, 0.0, math.pi / 2, 6.0]).double()
    torch.testing.assert_close(later.pose[0, 0], wanted)


def test_what_happened_leads_to_the_window_of_then(windows: Callable[..., WindowFile]) -> None:
    """Executing the logged future gives the same batch as collating a window file cut two steps later."""
    file = windows((6,), seed=4)
    everywhere = np.ones_like(file.past_valid), np.ones_like(file.future_valid)
    time, origin = np.arange(17), np.random.default_rng(0).uniform(-20, 20, (6, 1, 4))
    path = (origin + np.stack((2.0 * time, 0.5 * time, 0.1 * time, 0.0 * time), -1)).astype(np.float32)
    path[..., 3] = 4.0

    def cut(first: int) -> SceneBatch:
        future = np.zeros((6, 12, 4), dtype=np.float32)
        future[:, : 12 - first] = path[:, first + 5 :]
        valid = everywhere[1].copy()
        valid[:, 12 - first :] = False
        made = replace(
            file,
            past=path[:, first : first + 5],
            past_valid=everywhere[0],
            future=future,
            future_valid=valid,
        )
        return collate(made, np.array([0]))

    now, then = cut(0), cut(2)
    still = torch.zeros_like(now.future[..., 0])
    driven = Rollout(now.future[..., :2], now.future[..., 2], now.future[..., 3], still, still)
    later = now.advanced(driven.states()[:, :, :2])
    origin_now, origin_then = path[0, 4, :2], path[0, 6, :2]
    shift = torch.tensor(
        np.append(origin_then - origin_now, (0.0, 0.0))
    ).float()  # advance keeps the old origin
    for field in fields(SceneBatch):
        made, wanted = getattr(later, field.name), getattr(then, field.name)
        if field.name == "past":
            wanted = wanted + shift
        if field.name == "future":
            wanted = torch.where(then.future_valid[..., None], wanted + shift, 0.0)
        if field.name == "map_xy":
            made, wanted = made[now.map_valid], wanted[now.map_valid]
        if wanted.dtype == torch.bool:
            assert torch.equal(made, wanted), field.name
        else:
            torch.testing.assert_close(made, wanted, atol=2e-4, rtol=0.0)
