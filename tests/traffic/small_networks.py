"""Small untrained networks whose vehicles move, and a street scene on a shipped net."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.bundle import BundleOptions, new_bundle, save_bundle

MODEL = {
    "hidden": 32,
    "latent": 8,
    "edge": 8,
    "message": 16,
    "channels": (8, 16, 24),
    "reward_hidden": 16,
}
SEED = 2
"""Seed of weights with which the vehicles of the street below move and stay on the road."""


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def untrained(folder: Path, layers: int) -> str:
    """Return the file of an untrained bundle with other weights than the initial ones, which hardly move a vehicle."""
    bundle = new_bundle(BundleOptions.parse({"model": {**MODEL, "denoiser_layers": layers}}))
    generator = torch.Generator().manual_seed(SEED)
    for module in bundle.modules().values():
        for weight in module.parameters():
            weight.data += 0.05 * torch.randn(weight.shape, generator=generator)
    path = folder / "small.safetensors"
    save_bundle(bundle, path, ())
    return str(path)


@pytest.fixture(scope="session")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    return untrained(tmp_path_factory.mktemp("weights"), 1)


@pytest.fixture(scope="session")
def uncoupled(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return weights whose denoiser treats one vehicle at a time."""
    return untrained(tmp_path_factory.mktemp("uncoupled"), 0)


@pytest.fixture(scope="session")
def downtown(networks: Path) -> RoadMap:
    return RoadMap.read(networks / "downtown.net.xml")


@pytest.fixture(scope="session")
def street(downtown: RoadMap) -> Callable[..., Scene]:
    """Return a function (places, speeds) → a scene on one long lane; the first vehicle is the target.

    *places* are (metres along the lane, metres to the left); everybody has driven straight at its speed.
    """
    lanes = [x for x in downtown.lanes.values() if not x.is_internal and x.permits("passenger")]
    lane = max(lanes, key=lambda x: (x.length_m, x.id))

    def make(places: list[tuple[float, float]], speeds: list[float]) -> Scene:
        s = np.array([p[0] for p in places])
        d = np.array([p[1] for p in places])
        past = np.arange(-4, 1) * 0.5
        along = s[:, None] + np.array(speeds)[:, None] * past
        xy, yaw = lane.line.at(along, np.repeat(d[:, None], 5, axis=1), extrapolate=True)
        count = len(places)
        history = Tracks(
            ids=tuple(f"v{k}" for k in range(count)),
            classes=np.zeros(count, dtype=np.int64),
            size_m=np.tile([4.6, 1.9], (count, 1)),
            xy_m=xy,
            yaw_rad=yaw,
            speed_mps=np.repeat(np.array(speeds)[:, None], 5, axis=1),
            valid=np.ones((count, 5), dtype=np.bool_),
            t0_s=-2.0,
            dt_s=0.5,
        )
        movable = np.arange(count) > 0
        return Scene(history, 0, movable, ((lane.edge_id,),) * count, {})

    return make


def moved_by(scene: Scene, shift: tuple[float, float]) -> Scene:
    """Return *scene* with all positions shifted."""
    return replace(scene, history=replace(scene.history, xy_m=scene.history.xy_m + np.asarray(shift)))
