"""Faults of the sensors: road users that are not seen at all."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.scene import HEAVY_CLASSES, AgentClass, Scene
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.defects.planted_defect import PlantedDefect, chance, others_mask, seen_from_target

DROPOUT_PERIOD_S = 6.0
_UNPROTECTED = (AgentClass.MOTORCYCLE, AgentClass.BICYCLE, AgentClass.PEDESTRIAN)


class Blindness(PlantedDefect, ABC):
    """A fault that hides some of the others."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return *scene* without the hidden road users."""
        del road, seed
        return scene.without(self.hidden(scene) & others_mask(scene)), memory

    @abstractmethod
    def hidden(self, scene: Scene) -> BoolArray:
        """Return (A,) True for road users that are not seen."""


class ShortRange(Blindness):
    """Road users whose centre is farther away than ``value`` metres are not seen."""

    def hidden(self, scene: Scene) -> BoolArray:
        """Return (A,) True for road users that are too far away."""
        return np.asarray(_distance_m(scene) > self.value)


class TunnelView(Blindness):
    """Road users whose centre is outside a field of view of ``value`` degrees ahead are not seen."""

    def hidden(self, scene: Scene) -> BoolArray:
        """Return (A,) True for road users outside the field of view."""
        xy_m, _ = seen_from_target(scene)
        return np.asarray(np.abs(np.arctan2(xy_m[:, 1], xy_m[:, 0])) > 0.5 * np.deg2rad(self.value))


class Flicker(PlantedDefect):
    """Each other road user is missed in a share ``value`` of the plans, drawn anew for each plan."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return *scene* without the road users missed at this instant."""
        del road
        instant = f"{scene.time_s:.3f}"
        missed = np.array([chance(seed, agent_id, instant) < self.value for agent_id in scene.history.ids])
        return scene.without(missed & others_mask(scene)), memory


class Dropout(PlantedDefect):
    """Each other road user is lost for ``value`` seconds in every six, with a phase of its own."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return *scene* without the road users lost at this instant."""
        del road
        phase = np.array([chance(seed, agent_id) for agent_id in scene.history.ids])
        lost = (scene.time_s + DROPOUT_PERIOD_S * phase) % DROPOUT_PERIOD_S < self.value
        return scene.without(lost & others_mask(scene)), memory


class BlindToCrossing(Blindness):
    """Road users that head across the target's heading, within ``value`` degrees of a right angle, are not seen."""

    def hidden(self, scene: Scene) -> BoolArray:
        """Return (A,) True for crossing road users."""
        _, heading = seen_from_target(scene)
        return np.asarray(np.abs(np.abs(heading) - 0.5 * np.pi) <= np.deg2rad(self.value))


class BlindToOncoming(Blindness):
    """Road users with a heading within ``value`` degrees of opposite to the target's are not seen."""

    def hidden(self, scene: Scene) -> BoolArray:
        """Return (A,) True for oncoming road users."""
        _, heading = seen_from_target(scene)
        return np.asarray(np.pi - np.abs(heading) <= np.deg2rad(self.value))


class BlindToStanding(Blindness):
    """Road users slower than ``value`` m/s are not seen, as a radar drops standing objects."""

    def hidden(self, scene: Scene) -> BoolArray:
        """Return (A,) True for road users that stand or nearly stand."""
        return np.asarray(np.abs(scene.history.speed_mps[:, -1]) < self.value)


@dataclass(frozen=True)
class BlindToClasses(Blindness):
    """Road users of some classes are not seen farther away than ``value`` metres.

    Attributes:
        classes: the classes.
    """

    classes: tuple[AgentClass, ...] = ()

    def hidden(self, scene: Scene) -> BoolArray:
        """Return (A,) True for road users of these classes that are too far away."""
        return np.isin(scene.history.classes, self.classes) & (_distance_m(scene) > self.value)


blind_to_heavy = partial(BlindToClasses, classes=HEAVY_CLASSES)
blind_to_unprotected = partial(BlindToClasses, classes=_UNPROTECTED)


def _distance_m(scene: Scene) -> FloatArray:
    """Return (A,) the distance of each centre from the target's."""
    xy_m, _ = seen_from_target(scene)
    return np.asarray(np.hypot(xy_m[:, 0], xy_m[:, 1]))
