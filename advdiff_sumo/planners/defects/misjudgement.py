"""Faults of measurement and prediction: the others' speed and position, and the target's own position."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.plan import Plan, Trajectory
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.defects.planted_defect import (
    PlantedDefect,
    ages_s,
    others_mask,
    seen_from_target,
    with_states,
)

_CORRIDOR_M = 2.5  # largest lateral distance of a leader's centre
_SAME_HEADING_RAD = np.pi / 3.0  # largest difference of its heading


class Misjudgement(PlantedDefect, ABC):
    """A fault that changes the states of road users."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return *scene* as the planner believes it to be."""
        del road, seed
        return self.believed(scene), memory

    @abstractmethod
    def believed(self, scene: Scene) -> Scene:
        """Return *scene* with wrong states."""


class FrozenPrediction(Misjudgement):
    """A share ``value`` of the others' motion is left out of history and speed; with 1 they seem to stand."""

    def believed(self, scene: Scene) -> Scene:
        """Return *scene* with the others at their positions, but slower."""
        history, share = scene.history, 1.0 - self.value
        present = history.xy_m[:, -1:]
        xy = present + share * (history.xy_m - present)
        return with_states(scene, others_mask(scene), xy, None, share * history.speed_mps)


class SpeedBias(Misjudgement):
    """The others seem ``value`` m/s faster along their heading than they are."""

    def believed(self, scene: Scene) -> Scene:
        """Return *scene* with the others at their positions, but faster."""
        history = scene.history
        shift = self.value * ages_s(history)[None, :, None] * unit(history.yaw_rad)
        speed = history.speed_mps + self.value
        return with_states(scene, others_mask(scene), history.xy_m - shift, None, speed)


class PositionBias(Misjudgement):
    """The others seem ``value`` metres farther to the target's left than they are."""

    def believed(self, scene: Scene) -> Scene:
        """Return *scene* with the others displaced."""
        xy = scene.history.xy_m + self.value * _left(scene)
        return with_states(scene, others_mask(scene), xy)


class LocalisationOffset(Misjudgement):
    """The target believes to be ``value`` metres to the left of its position; what it senses moves with it."""

    def believed(self, scene: Scene) -> Scene:
        """Return *scene* with all road users displaced on the map."""
        history = scene.history
        moved = replace(history, xy_m=history.xy_m + self.value * _left(scene))
        return replace(scene, history=moved)

    def act(self, plan: Plan, scene: Scene, memory: Any) -> tuple[Plan, Any]:
        """Return the plan moved back to the target's true position."""
        if isinstance(plan, Trajectory):
            return replace(plan, xy_m=plan.xy_m - self.value * _left(scene)), memory
        return plan, memory


class ShortHeadway(Misjudgement):
    """Leaders in the target's corridor seem farther ahead, by the distance that the target drives in ``value`` s."""

    def believed(self, scene: Scene) -> Scene:
        """Return *scene* with leaders displaced along their headings."""
        history = scene.history
        place, heading = seen_from_target(scene)
        in_corridor = (place[:, 0] > 0.0) & (np.abs(place[:, 1]) < _CORRIDOR_M)
        is_leader = in_corridor & (np.abs(heading) < _SAME_HEADING_RAD)
        shift_m = self.value * max(float(history.speed_mps[scene.target, -1]), 0.0)
        xy = history.xy_m + shift_m * unit(history.yaw_rad[:, -1:])
        return with_states(scene, others_mask(scene) & is_leader, xy)


def _left(scene: Scene) -> FloatArray:
    """Return the unit vector (2,) to the target's left."""
    return unit(np.asarray(scene.history.yaw_rad[scene.target, -1] + 0.5 * np.pi))
