"""Faults of tracking in time: the others as they were, or as they would be had they not braked or turned since."""

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
from advdiff_sumo.planners.defects.planted_fault import PlantedFault, others_of, with_states

_SLACK_S = 1e-6


@dataclass(frozen=True)
class _Past:
    """What was seen so far.

    Attributes:
        states: name → (N, 5) time (s), x, y (m), continuous yaw (rad), speed (m/s), rising in time.
        signals: (time, id → state string), rising in time.
    """

    states: Mapping[str, FloatArray]
    signals: tuple[tuple[float, Mapping[str, str]], ...] = ()


class Late(PlantedFault):
    """The others and the signals are seen as they were ``value`` seconds ago; who came since is not seen."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return the scene of ``value`` seconds ago, with the target as it is."""
        del road, seed
        history = scene.history
        past = _with(memory, scene, self.value + history.dt_s * history.steps)
        then = history.times_s - self.value
        xy, yaw, speed, valid = _empty(scene)
        for row, name in enumerate(history.ids):
            known = past.states.get(name)
            if known is not None:
                xy[row], yaw[row], speed[row], valid[row] = _at(known, then)
        rows = others_of(scene)
        late = with_states(scene, rows, xy, yaw, speed)
        shown = np.where(rows[:, None], valid, history.valid)
        late = replace(late, history=replace(late.history, valid=shown))
        earlier = [signals for time, signals in past.signals if time <= scene.time_s - self.value + _SLACK_S]
        late = replace(late, signals=earlier[-1] if earlier else past.signals[0][1])
        return late.without(rows & ~shown[:, -1]), past


class ConstantVelocity(PlantedFault):
    """The others are believed to have gone straight on at the same speed for the last ``value`` seconds."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return where the others would be had they kept the velocity that they had ``value`` seconds ago."""
        del road, seed
        history = scene.history
        past = _with(memory, scene, self.value + history.dt_s * history.steps)
        xy, yaw, speed, _ = _empty(scene)
        for row, name in enumerate(history.ids):
            known = past.states.get(name)
            if known is None:
                continue
            then = np.maximum(history.times_s - self.value, known[0, 0])
            xy[row], yaw[row], speed[row], _ = _at(known, then)
            gone = speed[row] * (history.times_s - then)
            xy[row] += gone[:, None] * unit(yaw[row])
        believed = with_states(scene, others_of(scene), xy, yaw, speed)
        return replace(believed, history=believed.history.where(history.valid)), past


def _with(memory: Any, scene: Scene, span_s: float) -> _Past:
    """Return what is known with *scene* added and what is older than *span_s* dropped."""
    before: _Past = memory if memory is not None else _Past({})
    history, states = scene.history, {}
    for row, name in enumerate(history.ids):
        there = history.valid[row]
        observed = np.column_stack(
            (history.times_s, history.xy_m[row], history.yaw_rad[row], history.speed_mps[row])
        )[there]
        known = before.states.get(name)
        if known is not None and len(known):
            observed = np.concatenate((known, observed[observed[:, 0] > known[-1, 0] + _SLACK_S]))
        observed = observed[observed[:, 0] >= scene.time_s - span_s - _SLACK_S]
        if len(observed):
            observed[:, 3] = np.unwrap(observed[:, 3])
            states[name] = observed
    signals = [x for x in before.signals if scene.time_s - span_s <= x[0] < scene.time_s - _SLACK_S]
    return _Past(states, (*signals, (scene.time_s, scene.signals)))


def _at(known: FloatArray, then_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, Any]:
    """Return places (T, 2), headings (T,), speeds (T,) and validity (T,) at *then_s*; NaN before the first."""
    valid = (then_s >= known[0, 0] - _SLACK_S) & (then_s <= known[-1, 0] + _SLACK_S)
    x, y, yaw, speed = (
        np.where(valid, np.interp(then_s, known[:, 0], known[:, k]), np.nan) for k in range(1, 5)
    )
    return np.column_stack((x, y)), wrap_angle(yaw), speed, valid


def _empty(scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray, Any]:
    shape = scene.history.yaw_rad.shape
    return (
        np.full((*shape, 2), np.nan),
        np.full(shape, np.nan),
        np.full(shape, np.nan),
        np.zeros(shape, np.bool_),
    )
