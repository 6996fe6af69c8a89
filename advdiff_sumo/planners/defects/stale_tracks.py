"""Faults of tracking: the others as they were, or moved on with an old velocity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit, wrap_angle
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.defects.planted_defect import PlantedDefect, others_mask, with_states

_SLACK_S = 1e-6


@dataclass(frozen=True)
class _Past:
    """What was seen so far.

    Attributes:
        states: id → (N, 5) time (s), x, y (m), unwrapped yaw (rad), speed (m/s), in order of time.
        signals: (time, signal id → state string), in order of time.
    """

    states: Mapping[str, FloatArray]
    signals: tuple[tuple[float, Mapping[str, str]], ...] = ()


class Late(PlantedDefect):
    """The others and the signals are seen as they were ``value`` seconds ago; later arrivals are not seen."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return the scene of ``value`` seconds ago with the present target."""
        del road, seed
        history = scene.history
        past = _recorded(memory, scene, self.value + history.dt_s * history.steps)
        times_s = history.times_s - self.value
        xy, yaw, speed, valid = _empty(scene)
        for row, agent_id in enumerate(history.ids):
            track = past.states.get(agent_id)
            if track is not None:
                xy[row], yaw[row], speed[row], valid[row] = _states_at(track, times_s)
        rows = others_mask(scene)
        late = with_states(scene, rows, xy, yaw, speed)
        is_seen = np.where(rows[:, None], valid, history.valid)
        late = replace(late, history=replace(late.history, valid=is_seen))
        earlier = [signals for time, signals in past.signals if time <= scene.time_s - self.value + _SLACK_S]
        late = replace(late, signals=earlier[-1] if earlier else past.signals[0][1])
        return late.without(rows & ~is_seen[:, -1]), past


class ConstantVelocity(PlantedDefect):
    """The others seem to have kept their velocity of ``value`` seconds ago since then."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return *scene* with the others where constant velocity would have taken them."""
        del road, seed
        history = scene.history
        past = _recorded(memory, scene, self.value + history.dt_s * history.steps)
        xy, yaw, speed, _ = _empty(scene)
        for row, agent_id in enumerate(history.ids):
            track = past.states.get(agent_id)
            if track is None:
                continue
            times_s = np.maximum(history.times_s - self.value, track[0, 0])
            xy[row], yaw[row], speed[row], _ = _states_at(track, times_s)
            driven_m = speed[row] * (history.times_s - times_s)
            xy[row] += driven_m[:, None] * unit(yaw[row])
        believed = with_states(scene, others_mask(scene), xy, yaw, speed)
        return replace(believed, history=believed.history.where(history.valid)), past


def _recorded(memory: Any, scene: Scene, span_s: float) -> _Past:
    """Return the past with *scene* added, without what is older than *span_s*."""
    previous: _Past = memory if memory is not None else _Past({})
    history, states = scene.history, {}
    for row, agent_id in enumerate(history.ids):
        is_valid = history.valid[row]
        observed = np.column_stack(
            (history.times_s, history.xy_m[row], history.yaw_rad[row], history.speed_mps[row])
        )[is_valid]
        track = previous.states.get(agent_id)
        if track is not None and len(track):
            observed = np.concatenate((track, observed[observed[:, 0] > track[-1, 0] + _SLACK_S]))
        observed = observed[observed[:, 0] >= scene.time_s - span_s - _SLACK_S]
        if len(observed):
            observed[:, 3] = np.unwrap(observed[:, 3])
            states[agent_id] = observed
    signals = [x for x in previous.signals if scene.time_s - span_s <= x[0] < scene.time_s - _SLACK_S]
    return _Past(states, (*signals, (scene.time_s, scene.signals)))


def _states_at(track: FloatArray, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, Any]:
    """Return positions (T, 2), headings, speeds and validity (T,) at *times_s*; NaN outside the track."""
    valid = (times_s >= track[0, 0] - _SLACK_S) & (times_s <= track[-1, 0] + _SLACK_S)
    x, y, yaw, speed = (
        np.where(valid, np.interp(times_s, track[:, 0], track[:, k]), np.nan) for k in range(1, 5)
    )
    return np.column_stack((x, y)), wrap_angle(yaw), speed, valid


def _empty(scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray, Any]:
    """Return positions, headings and speeds of NaN, and validity False, shaped as in the history of *scene*."""
    shape = scene.history.yaw_rad.shape
    return (
        np.full((*shape, 2), np.nan),
        np.full(shape, np.nan),
        np.full(shape, np.nan),
        np.zeros(shape, np.bool_),
    )
