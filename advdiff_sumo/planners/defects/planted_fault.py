"""What a planted fault may do: change what the planner is given, hold its last plan, change what it returns."""

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
class PlantedFault:
    """One planted fault; it keeps nothing between calls, its memory comes in and goes out.

    Attributes:
        value: its severity, in the unit of its entry in the catalogue.
    """

    value: float

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return what the planner is given in place of *scene*, and the new memory (None at first)."""
        del road, seed
        return scene, memory

    def held_plan(self, scene: Scene, memory: Any) -> Plan | None:
        """Return the plan that is driven on without asking the planner; None where it is asked."""
        del scene, memory
        return None

    def act(self, plan: Plan, scene: Scene, memory: Any) -> tuple[Plan, Any]:
        """Return what is driven in place of *plan*, and the new memory; *scene* is what ``perceive`` was given."""
        del scene
        return plan, memory


def others_of(scene: Scene) -> BoolArray:
    """Return (A,) who is not the target."""
    return np.asarray(np.arange(scene.history.agents) != scene.target)


def with_states(
    scene: Scene,
    rows: BoolArray,
    xy_m: FloatArray | None = None,
    yaw_rad: FloatArray | None = None,
    speed_mps: FloatArray | None = None,
) -> Scene:
    """Return *scene* in which *rows* (A,) have other states; arrays as in its history, None for unchanged."""
    history = scene.history
    parts: dict[str, Any] = {
        name: np.where(rows.reshape(-1, *(1,) * (values.ndim - 1)), values, getattr(history, name))
        for name, values in (("xy_m", xy_m), ("yaw_rad", yaw_rad), ("speed_mps", speed_mps))
        if values is not None
    }
    return replace(scene, history=replace(history, **parts))


def seen_from_target(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Return where all are now in the target's frame, (A, 2) metres ahead and to the left, and headings (A,)."""
    history, row = scene.history, scene.target
    yaw = float(history.yaw_rad[row, -1])
    place = local_from_world(history.xy_m[:, -1], history.xy_m[row, -1], np.asarray(yaw))
    return place, wrap_angle(history.yaw_rad[:, -1] - yaw)


def ages_s(history: Tracks) -> FloatArray:
    """Return (T,) how long ago each instant was, 0 for the last."""
    return np.asarray(history.dt_s * np.arange(history.steps - 1, -1, -1), dtype=np.float64)


def chance(seed: SeedTree, *names: object) -> float:
    """Return a number in [0, 1) that belongs to *names*: the same whoever else is around and however severe it is."""
    return float(seed.child(*names).integer(53)) / 2.0**53
