"""Define a planted fault: it can change the scene, repeat an earlier plan, and change the plan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import local_from_world, wrap_angle
from advdiff_sumo.core.plan import Plan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap


@dataclass(frozen=True)
class PlantedDefect:
    """One planted fault. It keeps no state between calls: its memories are passed in and returned.

    Attributes:
        value: severity, in the unit of its entry in the catalogue.
    """

    value: float

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return the scene that the planner gets instead of *scene*, and the new memory (None at first)."""
        del road, seed
        return scene, memory

    def held_plan(self, scene: Scene, memory: Any) -> Plan | None:
        """Return an earlier plan to continue instead of a new one; None for a new plan."""
        del scene, memory
        return None

    def act(self, plan: Plan, scene: Scene, memory: Any) -> tuple[Plan, Any]:
        """Return the plan to drive instead of *plan*, and the new memory; *scene*: as passed to ``perceive``."""
        del scene
        return plan, memory


def others_mask(scene: Scene) -> BoolArray:
    """Return (A,) True for every agent except the target."""
    return np.asarray(np.arange(scene.history.agents) != scene.target)


def with_states(
    scene: Scene,
    rows: BoolArray,
    xy_m: FloatArray | None = None,
    yaw_rad: FloatArray | None = None,
    speed_mps: FloatArray | None = None,
) -> Scene:
    """Return *scene* with other states of *rows* (A,); arrays as in its history, None for unchanged ones."""
    history = scene.history
    changed: dict[str, Any] = {
        name: np.where(rows.reshape(-1, *(1,) * (values.ndim - 1)), values, getattr(history, name))
        for name, values in (("xy_m", xy_m), ("yaw_rad", yaw_rad), ("speed_mps", speed_mps))
        if values is not None
    }
    return replace(scene, history=replace(history, **changed))


def seen_from_target(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Return present positions (A, 2), metres ahead and to the left of the target, and relative headings (A,)."""
    history, row = scene.history, scene.target
    yaw = float(history.yaw_rad[row, -1])
    xy_m = local_from_world(history.xy_m[:, -1], history.xy_m[row, -1], np.asarray(yaw))
    return xy_m, wrap_angle(history.yaw_rad[:, -1] - yaw)


def ages_s(history: Tracks) -> FloatArray:
    """Return (T,) the age of each instant, 0 for the last."""
    return np.asarray(history.dt_s * np.arange(history.steps - 1, -1, -1), dtype=np.float64)


def chance(seed: SeedTree, *names: object) -> float:
    """Return a number in [0, 1) that depends on seed and *names* only, not on other road users or the severity."""
    return float(seed.child(*names).integer(53)) / 2.0**53
