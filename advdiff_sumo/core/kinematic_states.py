"""Positions, headings and speeds of vehicles as NumPy arrays, of which futures and plans consist.

The counterpart in tensors is :class:`~advdiff_sumo.models.decoder.Rollout`. :class:`~advdiff_sumo.core.scene.Tracks`
also have names, sizes and gaps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from advdiff_sumo.core.arrays import FloatArray

if TYPE_CHECKING:
    from typing import Self  # of Python 3.11; a planner's server may run on 3.10


@dataclass(frozen=True)
class KinematicStates:
    """States of one vehicle or of several at T instants.

    Attributes:
        xy_m: (…, T, 2) box centres.
        yaw_rad: (…, T) headings.
        speed_mps: (…, T) speeds.
    """

    xy_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray

    def mapped(self, change: Callable[[FloatArray], FloatArray]) -> Self:
        """Return the states with *change* applied to each of the three arrays."""
        xy, yaw, speed = map(change, (self.xy_m, self.yaw_rad, self.speed_mps))
        return replace(self, xy_m=xy, yaw_rad=yaw, speed_mps=speed)
