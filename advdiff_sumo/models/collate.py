"""Converts scenes to tensors: window files for training, live histories at run time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from advdiff_sumo.config import Options
from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.window_files import WindowFile
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.model_options import FUTURE_STEPS

_Numbers: TypeAlias = NDArray[np.floating[Any]]
_SIGNALS = 3  # red, yellow, green
_EDGE, _TURN = 4, 6  # columns of ``maps.vector_map.Feature``


class Jitter(Options):
    """Augmentation: vehicles are displaced slightly from their true state, with the same future as target.

    So the model learns to return to the lane after errors of its own. Mirrored scenes turn traffic on the right into
    traffic on the left.

    Attributes:
        share: share of the vehicles that are displaced.
        lateral_m: standard deviation of the lateral displacement.
        yaw_rad: standard deviation of the heading error.
        speed_mps: standard deviation of the speed error, for moving vehicles.
        mirror: share of the scenes that are mirrored.
    """

    share: float = Field(0.4, ge=0.0, le=1.0)
    lateral_m: float = Field(0.3, ge=0.0)
    yaw_rad: float = Field(0.04, ge=0.0)
    speed_mps: float = Field(0.4, ge=0.0)
    mirror: float = Field(0.0, ge=0.0, le=1.0)


@dataclass(frozen=True)
class _Agents:
    """Padded agents (B, A, …) in one frame per scene, and the states (B, G) of the signals."""

    past: FloatArray
    past_valid: BoolArray
    future: FloatArray
    future_valid: BoolArray
    size: FloatArray
    classes: IntArray
    parked: BoolArray
    present: BoolArray
    near: IntArray
    signals: IntArray


def collate(
    windows: WindowFile, rows: IntArray, rng: np.random.Generator | None = None, jitter: Jitter | None = None
) -> SceneBatch:
    """Return windows *rows* (B,) as a batch, augmented by *jitter* with random numbers of *rng*; None: as they are."""
    rows = np.asarray(rows, dtype=np.int64)
    first, last = windows.offset[rows], windows.offset[rows + 1]
    agents = int((last - first).max())
    index = first[:, None] + np.arange(agents)
    present = index < last[:, None]
    index = np.where(present, index, first[:, None])
    padded = _Agents(
        past=windows.past[index].astype(np.float64),
        past_valid=windows.past_valid[index] & present[..., None],
        future=windows.future[index].astype(np.float64),
        future_valid=windows.future_valid[index] & present[..., None],
        size=windows.size[index].astype(np.float64),
        classes=windows.classes[index].astype(np.int64),
        parked=windows.parked[index] & present,
        present=present & windows.past_valid[index, -1],
        near=np.where(present[..., None], windows.near[index], -1),
        signals=windows.signals[rows].astype(np.int64),
    )
    if jitter is not None and rng is not None:
        padded = _displaced(padded, rng, jitter)
    batch = _assemble(padded, windows.map_xy, windows.map_features, windows.map_signal)
    if jitter is not None and rng is not None and jitter.mirror > 0.0:
        return mirrored(batch, torch.from_numpy(rng.random(batch.scenes) < jitter.mirror))
    return batch


def mirrored(batch: SceneBatch, which: torch.Tensor) -> SceneBatch:
    """Return *batch* with left and right exchanged in the scenes *which* (B,)."""
    sign = torch.where(which, -1.0, 1.0)[:, None, None, None]
    state = torch.cat((torch.ones_like(sign), sign, sign, torch.ones_like(sign)), dim=-1)
    map_xy = batch.map_xy * torch.cat((torch.ones_like(sign), sign), dim=-1)[..., None, :]
    edge = (batch.map_features[..., _EDGE] > 0.5) & which[:, None, None]  # the road stays on its left
    map_features = batch.map_features.clone()
    map_features[..., _TURN] *= sign[..., 0]
    return replace(
        batch,
        past=batch.past * state,
        future=batch.future * state,
        map_xy=torch.where(edge[..., None, None], map_xy.flip(-2), map_xy),
        map_features=map_features,
    )


def scene_batch(
    history: Tracks,
    map_xy: FloatArray,
    map_features: FloatArray,
    map_signal: IntArray,
    near: IntArray,
    signal_states: IntArray,
) -> SceneBatch:
    """Return one live scene as a batch of one scene, with an unknown future.

    Args:
        history: (A, H) states; all agents are present at the last instant.
        map_xy: (M, N, 2) map pieces.
        map_features: (M, F) features of the pieces.
        map_signal: (M,) index of the piece's signal, −1 if it has none.
        near: (A, K) pieces near each agent, padded with −1.
        signal_states: (G,) 0 unknown, 1 red, 2 yellow, 3 green.
    """
    agents = history.agents
    states = np.concatenate((history.xy_m, history.yaw_rad[..., None], history.speed_mps[..., None]), axis=-1)
    known = _Agents(
        past=states[None],
        past_valid=history.valid[None],
        future=np.zeros((1, agents, FUTURE_STEPS, 4)),
        future_valid=np.zeros((1, agents, FUTURE_STEPS), dtype=np.bool_),
        size=history.size_m[None],
        classes=history.classes[None],
        parked=np.zeros((1, agents), dtype=np.bool_),
        present=history.valid[None, :, -1],
        near=near[None],
        signals=np.asarray(signal_states, dtype=np.int64)[None],
    )
    return _assemble(known, map_xy, map_features, map_signal)


def _assemble(agents: _Agents, xy_m: _Numbers, features: _Numbers, signal: NDArray[np.integer]) -> SceneBatch:
    past, future = agents.past.copy(), agents.future.copy()
    origin = past[:, :1, -1, :2].copy()
    past[..., :2] -= origin[:, :, None]
    future[..., :2] -= origin[:, :, None]
    past[~agents.past_valid] = 0.0
    future[~agents.future_valid] = 0.0
    map_xy, map_valid = _seen(agents, xy_m)
    return SceneBatch(
        past=_floats(past),
        past_valid=torch.from_numpy(agents.past_valid),
        size=_floats(np.where(agents.present[..., None], agents.size, 1.0)),
        classes=torch.from_numpy(agents.classes),
        present=torch.from_numpy(agents.present),
        moved=torch.from_numpy(agents.present & (agents.classes != AgentClass.PEDESTRIAN)),
        parked=torch.from_numpy(agents.parked),
        map_xy=_floats(map_xy),
        map_features=_floats(_features(agents, features, signal) * map_valid[..., None]),
        map_valid=torch.from_numpy(map_valid),
        future=_floats(future),
        future_valid=torch.from_numpy(agents.future_valid),
    )


def _seen(agents: _Agents, xy_m: _Numbers) -> tuple[FloatArray, BoolArray]:
    """Return the pieces (B, A, K, N, 2) in each agent's frame, and which are no padding (B, A, K)."""
    valid = (agents.near >= 0) & agents.present[..., None]
    world = xy_m[np.maximum(agents.near, 0)].astype(np.float64)
    now = agents.past[:, :, -1]
    delta = world - now[:, :, None, None, :2]
    cos, sin = np.cos(now[..., 2])[:, :, None, None], np.sin(now[..., 2])[:, :, None, None]
    x, y = delta[..., 0], delta[..., 1]
    local = np.stack((cos * x + sin * y, cos * y - sin * x), axis=-1)
    return np.where(valid[..., None, None], local, 0.0), valid


def _features(agents: _Agents, features: _Numbers, signal: NDArray[np.integer]) -> FloatArray:
    """Return the pieces' features (B, A, K, F + 3), the last three the signal's state as one-hot vector."""
    near = np.maximum(agents.near, 0)
    lights, states = signal[near], np.zeros_like(near)
    if agents.signals.shape[1]:
        scenes = np.arange(len(near))[:, None, None]
        states = np.where(lights >= 0, agents.signals[scenes, np.maximum(lights, 0)], 0)
    lit = states[..., None] == np.arange(1, _SIGNALS + 1)
    return np.concatenate((features[near].astype(np.float64), lit), axis=-1)


def _displaced(agents: _Agents, rng: np.random.Generator, jitter: Jitter) -> _Agents:
    """Return *agents* with some vehicles displaced; the displacement grows linearly over the two seconds of past."""
    shape = agents.present.shape
    draw = rng.standard_normal((3, *shape))
    vehicle = agents.present & (agents.classes != AgentClass.PEDESTRIAN)
    hit = (rng.random(shape) < jitter.share) & vehicle & (agents.past[:, :, -1, 3] > 1.0)
    side, turn, faster = (hit * draw[k] for k in range(3))
    steps = agents.past.shape[2]
    share = np.linspace(0.0, 1.0, steps)
    yaw = agents.past[:, :, -1:, 2]
    past = agents.past.copy()
    past[..., 0] -= share * np.sin(yaw) * jitter.lateral_m * side[..., None]
    past[..., 1] += share * np.cos(yaw) * jitter.lateral_m * side[..., None]
    past[..., 2] += share * jitter.yaw_rad * turn[..., None]
    past[..., 3] = np.maximum(past[..., 3] + share * jitter.speed_mps * faster[..., None], 0.0)
    return replace(agents, past=past)


def _floats(array: FloatArray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
