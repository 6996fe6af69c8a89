"""Predictions without learning, on roads that are drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.training.baselines import constant_velocity, lane_ahead, lane_following
from advdiff_sumo.training.displacement import displacement
from tests.training.straight_road import make_windows


def straight(x0: float, x1: float, y: float = 0.0) -> np.ndarray:
    return np.stack((np.linspace(x0, x1, 6), np.full(6, y)), axis=-1)


def bend(x0: float, y0: float, radius: float, side: float) -> np.ndarray:
    """Return a quarter circle that begins at (x0, y0) along x and turns to *side*."""
    angle = np.linspace(0.0, np.pi / 2, 6)
    return np.stack((x0 + radius * np.sin(angle), y0 + side * radius * (1.0 - np.cos(angle))), axis=-1)


def test_who_drives_straight_at_constant_speed_is_predicted_exactly(batch: SceneBatch) -> None:
    steady = batch.future.clone()
    steps = torch.arange(1, 13) * 0.5
    steady[..., 0] = batch.pose[..., None, 0] + batch.pose[..., None, 3] * steps
    still = SceneBatch(**{**vars(batch), "future": steady})
    for predict in (constant_velocity, lane_following):
        total, number = displacement(predict(still), still).fde_sum()
        assert total / number == pytest.approx(0.0, abs=1e-3)


def test_the_lane_goes_on_where_the_piece_ends() -> None:
    pieces = np.array([straight(20, 40), straight(-10, 10), straight(10, 20), straight(-10, 10, y=4.0)])
    path = lane_ahead(pieces, 25.0)
    assert path is not None
    assert path[0].tolist() == [-10.0, 0.0]
    assert path[-1].tolist() == [40.0, 0.0]


def test_no_more_pieces_than_are_needed() -> None:
    path = lane_ahead(np.array([straight(-10, 10), straight(10, 20), straight(20, 40)]), 15.0)
    assert path is not None
    assert path[-1].tolist() == [20.0, 0.0]


def test_at_a_fork_the_way_that_turns_least_is_taken() -> None:
    pieces = np.array([straight(-10, 10), bend(10, 0, 12.0, 1.0), straight(10, 25), bend(10, 0, 12.0, -1.0)])
    path = lane_ahead(pieces, 20.0)
    assert path is not None
    assert path[-1].tolist() == [25.0, 0.0]


@pytest.mark.parametrize(
    "pieces",
    [
        np.zeros((0, 6, 2)),
        np.array([straight(-10, 10, y=4.0)]),  # too far to the side
        np.array([straight(10, -10)]),  # the other way
        np.array([straight(5, 20)[:, ::-1]]),  # across
    ],
)
def test_who_is_on_no_lane_has_no_path(pieces: np.ndarray) -> None:
    assert lane_ahead(pieces, 20.0) is None


def test_a_bend_is_followed_as_far_beside_the_middle_as_now() -> None:
    windows = make_windows(1, agents=2)
    from advdiff_sumo.models.collate import collate

    batch = collate(windows, np.arange(1))
    map_xy = torch.zeros_like(batch.map_xy)
    map_xy[0, 0, 0] = torch.from_numpy(straight(-10, 0, y=-0.5))  # half a metre to the right of the car
    for part in range(4):  # a quarter circle of 40 m to the left in four pieces of 22.5°
        angle = np.linspace(part, part + 1, 6) * np.pi / 8
        arc = np.stack((40.0 * np.sin(angle), 40.0 * (1.0 - np.cos(angle)) - 0.5), axis=-1)
        map_xy[0, 0, 1 + part] = torch.from_numpy(arc)
    valid = torch.zeros_like(batch.map_valid)
    valid[0, 0, :5] = True
    features = torch.zeros_like(batch.map_features)
    features[0, 0, :5, 2] = features[0, 0, :5, 8] = 1.0
    past = batch.past.clone()
    past[0, 0, :, 3] = 10.0
    past[0, 0, -1, :3] = 0.0
    values = {"past": past, "map_xy": map_xy, "map_valid": valid, "map_features": features}
    path = lane_following(SceneBatch(**{**vars(batch), **values}))
    radius = (path.xy[0, 0] - torch.tensor([0.0, 39.5])).norm(dim=-1)
    assert torch.allclose(radius, torch.full((12,), 39.5), atol=0.15)  # the middle has 40 m
    assert float(path.yaw[0, 0, -1]) == pytest.approx(np.pi / 2, abs=0.15)  # 60 m of 62.8 m
