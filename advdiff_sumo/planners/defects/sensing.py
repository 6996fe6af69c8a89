"""Faults of the sensors: who is not seen at all."""

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
from advdiff_sumo.planners.defects.planted_fault import PlantedFault, chance, others_of, seen_from_target

DROPOUT_PERIOD_S = 6.0
_UNPROTECTED = (AgentClass.MOTORCYCLE, AgentClass.BICYCLE, AgentClass.PEDESTRIAN)


class Blindness(PlantedFault, ABC):
    """A fault that hides some of the others."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return *scene* without those who are not seen."""
        del road, seed
        return scene.without(self.hidden(scene) & others_of(scene)), memory

    @abstractmethod
    def hidden(self, scene: Scene) -> BoolArray:
        """Return (A,) who is not seen."""


class ShortRange(Blindness):
    """Nobody is seen whose centre is farther than ``value`` metres."""

    def hidden(self, scene: Scene) -> BoolArray:
        """Return who is too far away."""
        return np.asarray(_distance_m(scene) > self.value)


class TunnelView(Blindness):
    """Nobody is seen whose centre is outside a field of view of ``value`` degrees ahead."""

    def hidden(self, scene: Scene) -> BoolArray:
        """Return who is outside the field of view."""
        place, _ = seen_from_target(scene)
        return np.asarray(np.abs(np.arctan2(place[:, 1], place[:, 0])) > 0.5 * np.deg2rad(self.value))


class Flicker(PlantedFault):
    """Each of the others is missed in a share ``value`` of the plans, each time anew."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return *scene* without those who are missed now."""
        del road
        now = f"{scene.time_s:.3f}"
        missed = np.array([chance(seed, name, now) < self.value for name in scene.history.ids])
        return scene.without(missed & others_of(scene)), memory


class Dropout(PlantedFault):
    """Each of the others is lost for ``value`` seconds in every six, each at a phase of its own."""

    def perceive(self, road: RoadMap, scene: Scene, memory: Any, seed: SeedTree) -> tuple[Scene, Any]:
        """Return *scene* without those who are lost now."""
        del road
        phase = np.array([chance(seed, name) for name in scene.history.ids])
        lost = (scene.time_s + DROPOUT_PERIOD_S * phase) % DROPOUT_PERIOD_S < self.value
        return scene.without(lost & others_of(scene)), memory


class BlindToCrossing(Blindness):
    """Nobody is seen who heads across the target's way, within ``value`` degrees of a right angle."""

    def hidden(self, scene: Scene) -> BoolArray:
        """Return who crosses."""
        _, heading = seen_from_target(scene)
        return np.asarray(np.abs(np.abs(heading) - 0.5 * np.pi) <= np.deg2rad(self.value))


class BlindToOncoming(Blindness):
    """Nobody is seen who comes towards the target, within ``value`` degrees of the opposite heading."""

    def hidden(self, scene: Scene) -> BoolArray:
        """Return who comes towards it."""
        _, heading = seen_from_target(scene)
        return np.asarray(np.pi - np.abs(heading) <= np.deg2rad(self.value))


class BlindToStanding(Blindness):
    """Nobody is seen who moves more slowly than ``value`` metres a second, as a radar drops what stands."""

    def hidden(self, scene: Scene) -> BoolArray:
        """Return who stands, or nearly."""
        return np.asarray(np.abs(scene.history.speed_mps[:, -1]) < self.value)


@dataclass(frozen=True)
class BlindToClasses(Blindness):
    """Road users of some classes are not recognised farther away than ``value`` metres.

    Attributes:
        classes: which.
    """

    classes: tuple[AgentClass, ...] = ()

    def hidden(self, scene: Scene) -> BoolArray:
        """Return who is of these classes and too far away."""
        return np.isin(scene.history.classes, self.classes) & (_distance_m(scene) > self.value)


blind_to_heavy = partial(BlindToClasses, classes=HEAVY_CLASSES)
blind_to_unprotected = partial(BlindToClasses, classes=_UNPROTECTED)


def _distance_m(scene: Scene) -> FloatArray:
    place, _ = seen_from_target(scene)
    return np.asarray(np.hypot(place[:, 0], place[:, 1]))
