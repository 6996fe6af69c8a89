"""Small networks with weights that matter, and crossings made of random agents and map pieces."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from torch import nn

from advdiff_sumo.core.map_view import MAP_PIECES
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.data.window_files import FUTURE, PAST, WindowFile
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.collate import collate
from advdiff_sumo.models.model_options import PIECE_POINTS, ModelOptions

WindowMaker = Callable[..., WindowFile]
SIGNALS = 3


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def options() -> ModelOptions:
    return ModelOptions(
        hidden=32, latent=8, edge=8, message=16, heads=4, channels=(8, 16, 16), reward_hidden=16
    )


@pytest.fixture(scope="session")
def lively() -> Callable[[nn.Module], nn.Module]:
    """Return a function that takes a network away from its cautious first weights (some are all zero)."""

    def stir(module: nn.Module) -> nn.Module:
        generator = torch.Generator().manual_seed(7)
        for weight in module.parameters():
            weight.data += 0.15 * torch.randn(weight.shape, generator=generator)
        return module.eval()

    return stir


def _turn(xy: np.ndarray, yaw: float) -> np.ndarray:
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.stack((cos * xy[..., 0] - sin * xy[..., 1], sin * xy[..., 0] + cos * xy[..., 1]), axis=-1)


@pytest.fixture(scope="session")
def windows() -> WindowMaker:
    """Return a function (counts, seed, turn, shift) → windows; *turn* and *shift* move the whole world."""

    def make(
        counts: tuple[int, ...] = (5, 3),
        seed: int = 0,
        turn: float = 0.0,
        shift: tuple[float, float] = (0, 0),
    ) -> WindowFile:
        rng = np.random.default_rng(seed)
        agents, pieces = sum(counts), 30
        yaw0, speed = rng.uniform(-np.pi, np.pi, agents), rng.uniform(2.0, 12.0, agents)
        rate, start = rng.uniform(-0.3, 0.3, agents), rng.uniform(-20.0, 20.0, (agents, 2))
        time = 0.5 * np.arange(1 - PAST, FUTURE + 1)
        yaw = yaw0[:, None] + rate[:, None] * time
        along = (speed[:, None] * time)[..., None] * np.stack((np.cos(yaw), np.sin(yaw)), axis=-1)
        xy = _turn(start[:, None] + along, turn) + np.asarray(shift)
        states = np.concatenate(
            (xy, yaw[..., None] + turn, np.broadcast_to(speed[:, None, None], (*yaw.shape, 1))), -1
        )
        past_valid = rng.random((agents, PAST)) < 0.8
        past_valid[:, -1] = True
        future_valid = rng.random((agents, FUTURE)) < 0.8
        middle, way = rng.uniform(-30.0, 30.0, (pieces, 1, 2)), rng.uniform(-8.0, 8.0, (pieces, 1, 2))
        points = middle + np.linspace(-1.0, 1.0, PIECE_POINTS)[:, None] * way
        features = np.zeros((pieces, 10))
        features[:, 0], features[:, 1] = 3.5, 13.9
        features[:20, 2], features[20:, 4] = 1.0, 1.0
        near = np.full((agents, sum(MAP_PIECES["near"])), -1)
        near[:, :12] = rng.permuted(np.tile(np.arange(20), (agents, 1)), axis=1)[:, :12]
        near[:, MAP_PIECES["near"][0] :][:, :8] = rng.permuted(
            np.tile(np.arange(20, 30), (agents, 1)), axis=1
        )[:, :8]
        classes = rng.choice([AgentClass.CAR, AgentClass.TRUCK, AgentClass.BICYCLE], agents)
        classes[2] = AgentClass.PEDESTRIAN
        return WindowFile(
            map_origin=np.zeros(2),
            map_xy=(_turn(points, turn) + np.asarray(shift)).astype(np.float32),
            map_features=features.astype(np.float32),
            map_signal=rng.integers(-1, SIGNALS, pieces).astype(np.int32),
            offset=np.concatenate(([0], np.cumsum(counts))).astype(np.int64),
            past=(states[:, :PAST] * past_valid[..., None]).astype(np.float32),
            past_valid=past_valid,
            future=(states[:, PAST:] * future_valid[..., None]).astype(np.float32),
            future_valid=future_valid,
            size=rng.uniform((3.5, 1.6), (9.0, 2.5), (agents, 2)).astype(np.float32),
            classes=classes.astype(np.uint8),
            parked=np.zeros(agents, dtype=np.bool_),
            near=near.astype(np.int32),
            signals=rng.integers(0, 4, (len(counts), SIGNALS)).astype(np.uint8),
            scene=np.zeros(len(counts), dtype=np.int32),
            scene_names=("made up",),
        )

    return make


@pytest.fixture
def batch(windows: WindowMaker) -> SceneBatch:
    """Return two scenes, of five and of three agents; agent 2 of the first one walks."""
    return collate(windows(), np.arange(2))


@pytest.fixture(scope="session")
def driving() -> Callable[..., SceneBatch]:
    """Return a function (poses (A, 4), size, edges, double) → one scene of cars, its edges given in the scene."""

    def make(
        poses: list[tuple[float, float, float, float]],
        size: tuple[float, float] = (4.0, 2.0),
        edges: list[list[tuple[float, float]]] | None = None,
        lanes: list[list[tuple[float, float]]] | None = None,
    ) -> SceneBatch:
        lines, edge_count = [*(lanes or []), *(edges or [])], len(edges or [])
        agents, pieces = len(poses), max(len(lines), 1)
        points = np.zeros((pieces, PIECE_POINTS, 2))
        features = np.zeros((1, agents, pieces, 13))
        for row, line in enumerate(lines):
            points[row] = line
            features[:, :, row, 4 if row >= len(lines) - edge_count else 2] = 1.0
        pose = np.array(poses)
        delta = points[None, None] - pose[None, :, None, None, :2]
        local = np.stack([_turn(delta[0, a], -pose[a, 2]) for a in range(agents)])[None]
        past = np.repeat(pose[None, :, None], 5, axis=2)
        there = torch.ones(1, agents, dtype=torch.bool)
        return SceneBatch(
            past=torch.tensor(past),
            past_valid=there[..., None].expand(-1, -1, 5).clone(),
            size=torch.tensor(size, dtype=torch.float64).expand(1, agents, 2).clone(),
            classes=torch.zeros(1, agents, dtype=torch.long),
            present=there,
            moved=there.clone(),
            parked=~there,
            map_xy=torch.tensor(local),
            map_features=torch.tensor(features),
            map_valid=torch.full((1, agents, pieces), bool(lines)),
            future=torch.zeros(1, agents, FUTURE, 4, dtype=torch.float64),
            future_valid=torch.zeros(1, agents, FUTURE, dtype=torch.bool),
        )

    return make


@pytest.fixture(scope="session")
def permuted() -> Callable[[SceneBatch, torch.Tensor], SceneBatch]:
    """Return a function that puts the agents of a batch into another order."""

    def shuffle(batch: SceneBatch, order: torch.Tensor) -> SceneBatch:
        return SceneBatch(**{f.name: getattr(batch, f.name)[:, order] for f in fields(batch)})

    return shuffle


@pytest.fixture(scope="session")
def padded() -> Callable[[SceneBatch], SceneBatch]:
    """Return a function that adds three absent agents and four absent pieces, full of rubbish, to a batch."""

    def pad(batch: SceneBatch) -> SceneBatch:
        generator = torch.Generator().manual_seed(3)

        def rubbish(x: torch.Tensor, more: int, dim: int) -> torch.Tensor:
            shape = list(x.shape)
            shape[dim] = more
            if x.dtype in (torch.bool, torch.long):
                return torch.zeros(shape, dtype=x.dtype)
            return 5.0 * torch.rand(shape, generator=generator, dtype=x.dtype) + 0.5

        wider = {
            name: torch.cat((value, rubbish(value, 4, 2)), 2)
            for name, value in vars(batch).items()
            if name.startswith("map_")
        }
        more = replace(batch, **wider)
        return SceneBatch(
            **{name: torch.cat((value, rubbish(value, 3, 1)), 1) for name, value in vars(more).items()}
        )

    return pad
