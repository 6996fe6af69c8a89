"""Windows and live histories as tensors, by hand: frames, signals, padding, displacement."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.window_files import WindowFile
from advdiff_sumo.maps.vector_map import Feature
from advdiff_sumo.models import model_options, road_edges
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.collate import Jitter, collate, mirrored, scene_batch
from advdiff_sumo.models.losses import off_road
from advdiff_sumo.training.displacement import logged_rollout
from tests.models.conftest import WindowMaker

NORTH = math.pi / 2
TIME = 0.5 * np.arange(-4, 13)


@pytest.fixture
def by_hand() -> WindowFile:
    """Return two windows on a map of two pieces: a lane along x = 100 … 105, y = 50, and an edge along x = 98.

    Window 0: a car at (100, 50) that drives north at 4 m/s, and a walker 10 m east of it, not seen before.
    Window 1: a bus at (105, 50) that stands and looks west, its future known for 1 s.
    """
    past, future = np.zeros((3, 5, 4)), np.zeros((3, 12, 4))
    past_valid, future_valid = np.ones((3, 5), dtype=np.bool_), np.ones((3, 12), dtype=np.bool_)
    for states, time in ((past, TIME[:5]), (future, TIME[5:])):
        states[0] = np.stack(
            (np.full_like(time, 100.0), 50.0 + 4.0 * time, *np.full((2, len(time)), NORTH)), axis=-1
        )
        states[0, :, 3] = 4.0
        states[1] = (110.0, 50.0, 0.0, 0.0)
        states[2] = (105.0, 50.0, math.pi, 0.0)
    past_valid[1, :4], future_valid[2, 2:] = False, False
    past[1, :4], future[2, 2:] = 0.0, 0.0
    xy = np.zeros((2, 6, 2))
    xy[0] = np.stack((np.linspace(100.0, 105.0, 6), np.full(6, 50.0)), axis=-1)
    xy[1] = np.stack((np.full(6, 98.0), np.linspace(55.0, 45.0, 6)), axis=-1)
    features = np.zeros((2, 10))
    features[0, [Feature.WIDTH_M, Feature.SPEED_MPS, Feature.IS_LANE]] = 3.0, 13.0, 1.0
    features[1, Feature.IS_ROAD_EDGE] = 1.0
    near = np.full((3, 4), -1)
    near[0, :2], near[1, 2], near[2, 0] = (0, 1), 1, 0
    return WindowFile(
        map_origin=np.array((1000.0, 2000.0)),
        map_xy=xy.astype(np.float32),
        map_features=features.astype(np.float32),
        map_signal=np.array((1, -1), dtype=np.int32),
        offset=np.array((0, 2, 3)),
        past=past.astype(np.float32),
        past_valid=past_valid,
        future=future.astype(np.float32),
        future_valid=future_valid,
        size=np.array(((4.0, 2.0), (0.5, 0.6), (12.0, 2.5)), dtype=np.float32),
        classes=np.array((AgentClass.CAR, AgentClass.PEDESTRIAN, AgentClass.BUS), dtype=np.uint8),
        parked=np.array((False, False, True)),
        near=near.astype(np.int32),
        signals=np.array(((3, 1), (3, 2)), dtype=np.uint8),
        scene=np.zeros(2, dtype=np.int32),
        scene_names=("by hand",),
    )


def close(made: torch.Tensor, wanted: object) -> bool:
    """Return whether *made* has the shape of *wanted* and is it to 1e-5."""
    right = torch.tensor(wanted, dtype=made.dtype)
    return made.shape == right.shape and torch.allclose(made, right, atol=1e-5, rtol=0.0)


def test_masks_and_padding(by_hand: WindowFile) -> None:
    batch = collate(by_hand, np.arange(2))
    assert (batch.scenes, batch.agents) == (2, 2)
    assert batch.present.tolist() == [[True, True], [True, False]]
    assert batch.moved.tolist() == [[True, False], [True, False]]  # the walker is no vehicle
    assert batch.parked.tolist() == [[False, False], [True, False]]
    assert batch.past_valid[0].tolist() == [[True] * 5, [False] * 4 + [True]]
    assert batch.future_valid[1].tolist() == [[True] * 2 + [False] * 10, [False] * 12]
    assert batch.map_valid[0].tolist() == [[True, True, False, False], [False, False, True, False]]
    assert not bool(batch.map_valid[1, 1].any())
    assert close(batch.size[1], [[12.0, 2.5], [1.0, 1.0]])
    for name in ("past", "future", "map_xy", "map_features"):
        assert not bool(getattr(batch, name)[1, 1].any()), name
        assert getattr(batch, name).dtype == torch.float32
    assert not bool(batch.past[0, 1, :4].any())
    assert not bool(batch.future[1, 0, 2:].any())
    assert not bool(batch.map_xy[~batch.map_valid].any())
    assert not bool(batch.map_features[~batch.map_valid].any())


def test_states_are_about_the_focal_agent(by_hand: WindowFile) -> None:
    batch = collate(by_hand, np.arange(2))
    assert close(batch.pose[0], [[0.0, 0.0, NORTH, 4.0], [10.0, 0.0, 0.0, 0.0]])
    assert close(batch.past[0, 0, 0], [0.0, -8.0, NORTH, 4.0])
    assert close(batch.future[0, 0, -1], [0.0, 24.0, NORTH, 4.0])
    assert close(batch.future[0, 1, 0], [10.0, 0.0, 0.0, 0.0])
    assert close(batch.pose[1, 0], [0.0, 0.0, math.pi, 0.0])


def test_pieces_are_seen_from_each_agent(by_hand: WindowFile) -> None:
    batch = collate(by_hand, np.arange(2))
    # the car looks north: the lane leaves to its right, the edge is 2 m to its left and comes towards it
    assert close(batch.map_xy[0, 0, 0], [[0.0, -float(k)] for k in range(6)])
    assert close(batch.map_xy[0, 0, 1], [[5.0 - 2.0 * k, 2.0] for k in range(6)])
    # the walker at (110, 50) looks east: the edge is 12 m behind it
    assert close(batch.map_xy[0, 1, 2], [[-12.0, 5.0 - 2.0 * k] for k in range(6)])
    # the bus at (105, 50) looks west: the lane ends under it
    assert close(batch.map_xy[1, 0, 0], [[5.0 - float(k), 0.0] for k in range(6)])


def test_signals_are_one_hot_behind_the_columns(by_hand: WindowFile) -> None:
    batch = collate(by_hand, np.arange(2))
    lane, edge = [3.0, 13.0, 1.0] + [0.0] * 7, [0.0] * 4 + [1.0] + [0.0] * 5
    assert close(batch.map_features[0, 0, 0], [*lane, 1.0, 0.0, 0.0])  # red in window 0
    assert close(batch.map_features[1, 0, 0], [*lane, 0.0, 1.0, 0.0])  # yellow in window 1
    assert close(batch.map_features[0, 0, 1], [*edge, 0.0, 0.0, 0.0])  # no signal there
    assert close(batch.map_features[0, 1, 2], [*edge, 0.0, 0.0, 0.0])
    for state, lit in ((0, [0.0, 0.0, 0.0]), (3, [0.0, 0.0, 1.0])):
        signals = np.array(((0, state), (0, state)), dtype=np.uint8)
        other = collate(replace(by_hand, signals=signals), np.array([0]))
        assert close(other.map_features[0, 0, 0, 10:], lit)


def test_a_map_without_signals(by_hand: WindowFile) -> None:
    bare = replace(
        by_hand, map_signal=np.full(2, -1, dtype=np.int32), signals=np.zeros((2, 0), dtype=np.uint8)
    )
    assert not bool(collate(bare, np.arange(2)).map_features[..., 10:].any())


def test_rows_in_any_order_and_twice(by_hand: WindowFile) -> None:
    both, mixed = collate(by_hand, np.arange(2)), collate(by_hand, np.array([1, 0, 1]))
    for field in fields(SceneBatch):
        value, wanted = getattr(mixed, field.name), getattr(both, field.name)
        assert torch.equal(value, wanted[[1, 0, 1]]), field.name


def test_the_window_file_is_left_as_it_was(by_hand: WindowFile) -> None:
    before = {n: np.copy(v) for n, v in vars(by_hand).items() if isinstance(v, np.ndarray)}
    batch = collate(by_hand, np.arange(2), np.random.default_rng(0), Jitter(share=1.0))
    batch.past.fill_(7.0)
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(by_hand, name), value, err_msg=name)


def test_columns_are_those_of_the_map_table() -> None:
    assert road_edges._ROAD_EDGE == Feature.IS_ROAD_EDGE
    assert len(Feature) + 3 == model_options.PIECE_FEATURES
    assert len(AgentClass) == model_options.CLASSES


def test_displacement_keeps_the_future_and_spares_walkers(windows: Callable[..., WindowFile]) -> None:
    file = windows((8, 8), seed=5)
    strong = Jitter(share=1.0, lateral_m=0.5, yaw_rad=0.1, speed_mps=1.0)
    plain = collate(file, np.arange(2))
    moved = collate(file, np.arange(2), np.random.default_rng(1), strong)
    origin = (moved.past - plain.past)[
        0, 2, -1, :2
    ]  # the walker stands still: what it moves, the origin does
    assert float(origin.norm()) > 0.01
    shift = moved.future[0] - plain.future[0]
    known = plain.future_valid[0]
    torch.testing.assert_close(shift[known][:, :2], origin.expand(int(known.sum()), 2), atol=1e-4, rtol=0.0)
    assert not bool(shift[known][:, 2:].any())
    change = (moved.past - plain.past)[0]
    change[..., :2] -= origin
    change[~plain.past_valid[0]] = 0.0
    assert float(change[2].abs().max()) < 1e-4
    vehicles = [0, 1, 3, 4, 5, 6, 7]
    now = change[vehicles, -1]
    yaw = plain.pose[0, vehicles, 2]
    along = now[:, 0] * torch.cos(yaw) + now[:, 1] * torch.sin(yaw)
    aside = now[:, 1] * torch.cos(yaw) - now[:, 0] * torch.sin(yaw)
    assert float(along.abs().max()) < 1e-4
    assert float(aside.abs().min()) > 1e-3
    for instant in range(5):  # the past bends linearly towards the place now
        seen = plain.past_valid[0, vehicles, instant]
        torch.testing.assert_close(
            change[vehicles, instant][seen][:, :3], 0.25 * instant * now[seen][:, :3], atol=2e-4, rtol=0.0
        )
    assert bool((moved.past[..., 3] >= 0.0).all())


def test_displaced_vehicles_see_the_map_from_where_they_are(by_hand: WindowFile) -> None:
    moved = collate(by_hand, np.arange(2), np.random.default_rng(3), Jitter(share=1.0))
    walker = moved.pose[0, 1, :2]  # at (110, 50) in the world
    car = torch.tensor([110.0, 50.0]) - walker  # the origin is the car
    turn = float(moved.pose[0, 0, 2])
    ahead, left = (
        torch.tensor([math.cos(turn), math.sin(turn)]),
        torch.tensor([-math.sin(turn), math.cos(turn)]),
    )
    delta = torch.tensor([100.0, 50.0]) - car
    assert float(delta.norm()) > 1e-3
    assert close(moved.map_xy[0, 0, 0, 0], [float(delta @ ahead), float(delta @ left)])


def test_displacement_hits_its_share_of_moving_vehicles(windows: Callable[..., WindowFile]) -> None:
    file = windows((300,), seed=2)
    slow = file.past.copy()
    slow[:100, :, 3] = 0.5
    file = replace(file, past=slow)
    jitter = Jitter(share=0.4, lateral_m=0.0, yaw_rad=0.04, speed_mps=0.0)
    plain, moved = (
        collate(file, np.array([0])),
        collate(file, np.array([0]), np.random.default_rng(0), jitter),
    )
    turned = (moved.pose[0, :, 2] - plain.pose[0, :, 2]).abs() > 1e-6
    assert not bool(turned[:100].any())  # standing or crawling
    assert float(turned[100:].float().mean()) == pytest.approx(0.4, abs=0.1)
    angle = (moved.pose[0, 100:, 2] - plain.pose[0, 100:, 2])[turned[100:]]
    assert float(angle.std()) == pytest.approx(0.04, rel=0.25)


def test_displacement_is_repeatable_and_needs_a_generator(windows: Callable[..., WindowFile]) -> None:
    file, rows = windows(), np.arange(2)
    a, b, c = (collate(file, rows, np.random.default_rng(s), Jitter(share=1.0)) for s in (1, 1, 2))
    assert torch.equal(a.past, b.past)
    assert torch.equal(a.map_xy, b.map_xy)
    assert not torch.equal(a.past, c.past)
    assert torch.equal(collate(file, rows, None, Jitter()).past, collate(file, rows).past)


def test_a_live_scene_is_the_same_as_its_window(by_hand: WindowFile) -> None:
    states, valid = by_hand.past[:2].astype(np.float64), by_hand.past_valid[:2]
    states = np.where(valid[..., None], states, np.nan)
    history = Tracks(
        ids=("car", "walker"),
        classes=by_hand.classes[:2].astype(np.int64),
        size_m=by_hand.size[:2].astype(np.float64),
        xy_m=states[..., :2],
        yaw_rad=states[..., 2],
        speed_mps=states[..., 3],
        valid=valid,
        t0_s=-2.0,
        dt_s=0.5,
    )
    live = scene_batch(
        history,
        by_hand.map_xy.astype(np.float64),
        by_hand.map_features.astype(np.float64),
        by_hand.map_signal.astype(np.int64),
        by_hand.near[:2].astype(np.int64),
        by_hand.signals[0].astype(np.int64),
    )
    wanted = collate(by_hand, np.array([0]))
    for field in fields(SceneBatch):
        made, value = getattr(live, field.name), getattr(wanted, field.name)
        if field.name.startswith("future"):
            assert made.shape == value.shape
            assert not bool(made.any())
        else:
            torch.testing.assert_close(made, value)


def test_a_mirrored_scene_is_the_same_scene_with_left_and_right_exchanged(windows: WindowMaker) -> None:
    batch = collate(windows(), np.arange(2))
    which = torch.tensor([True, False])
    other = mirrored(batch, which)
    for name in ("past", "future"):
        mine, theirs = getattr(batch, name), getattr(other, name)
        torch.testing.assert_close(theirs[0], mine[0] * torch.tensor([1.0, -1.0, -1.0, 1.0]))
        torch.testing.assert_close(theirs[1], mine[1])
    lanes = batch.map_features[0, :, :, Feature.IS_LANE] > 0.5
    torch.testing.assert_close(other.map_xy[0][lanes], batch.map_xy[0][lanes] * torch.tensor([1.0, -1.0]))
    edges = batch.map_features[0, :, :, Feature.IS_ROAD_EDGE] > 0.5
    torch.testing.assert_close(  # the road stays on the edge's left
        other.map_xy[0][edges], batch.map_xy[0][edges].flip(-2) * torch.tensor([1.0, -1.0])
    )
    turn = batch.map_features[..., Feature.TURN]
    torch.testing.assert_close(other.map_features[0, ..., Feature.TURN], -turn[0])
    torch.testing.assert_close(off_road(logged_rollout(other), other), off_road(logged_rollout(batch), batch))
    again = mirrored(other, which)
    torch.testing.assert_close(again.map_xy, batch.map_xy)
    torch.testing.assert_close(again.map_features, batch.map_features)


def test_jitter_mirrors_the_share_that_is_asked_for(windows: WindowMaker) -> None:
    rows = np.tile(np.arange(2), 200)
    plain = collate(windows(), rows)
    jitter = Jitter(share=0.0, mirror=0.25)
    drawn = collate(windows(), rows, np.random.default_rng(3), jitter)
    turned = (drawn.future[:, :, :, 1] != plain.future[:, :, :, 1]).flatten(1).any(1)
    assert 70 < int(turned.sum()) < 130
