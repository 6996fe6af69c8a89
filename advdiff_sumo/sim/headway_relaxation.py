"""Let drivers that SUMO takes back close to their leader return to their own headway gradually.

SUMO brakes such a driver at once, with up to 9 m/s², and its follower runs into it. People accept a short gap and widen
it slowly: relaxation (Schakel, Knoop and van Arem 2012, doi:10.3141/2316-06, τ = 25 s).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from advdiff_sumo.sim.actuate import Actuator
from advdiff_sumo.sim.sumo_perception import leader_of
from advdiff_sumo.sim.world import World

RELAXATION_S = 25.0
_LEADER_RANGE_M = 60.0
_RELAXED_SHARE = 0.98
"""From this share of its own headway on, a driver gets all of it back."""
_MIN_SHARE = 0.05
_MAX_CLOSING_MPS = 1.0
"""A driver that approaches its leader faster than this keeps its own headway, and brakes."""


@dataclass(frozen=True)
class Headway:
    """The headway of a driver.

    Attributes:
        min_gap_m: gap at standstill.
        tau_s: time gap in addition to it.
        share: of both, that the driver keeps at present.
    """

    min_gap_m: float
    tau_s: float
    share: float = 1.0


class HeadwayRelaxation:
    """Drivers of one episode whose headway is shorter than their own.

    Args:
        actuator: of the episode; gives access to SUMO.
        world: rows and states.
        least_tau_s: shortest time gap with which SUMO can drive.
    """

    def __init__(self, actuator: Actuator, world: World, least_tau_s: float) -> None:
        self.actuator, self.world, self.least_tau_s = actuator, world, least_tau_s
        self._relaxing: dict[int, Headway] = {}

    def begin(self, row: int) -> None:
        """Let *row*, which SUMO has just taken back, keep its present gap if that is shorter than its own headway.

        A driver that closes in, for example on a standing vehicle, brakes as SUMO's drivers do.
        """
        leader = self._leader(row)
        own = self._relaxing.get(row) or self._own_headway(row)
        share = self._share(row, own, leader) if self._follows_steadily(row, leader) else 1.0
        if share < 1.0:
            self._set(row, replace(own, share=share))
        elif row in self._relaxing:
            self._restore(row)

    def advance(self, elapsed_s: float) -> None:
        """Bring all drivers closer to their own headway, *elapsed_s* after the last call."""
        for row, own in list(self._relaxing.items()):
            if row not in self.world.in_sumo:
                del self._relaxing[row]
                continue
            relaxed_share = own.share + (1.0 - own.share) * elapsed_s / RELAXATION_S
            share = max(relaxed_share, self._share(row, own, self._leader(row)))
            if row in self.actuator.moved or share >= _RELAXED_SHARE:
                self._restore(row)
            else:
                self._set(row, replace(own, share=share))

    def _leader(self, row: int) -> tuple[str, float] | None:
        return leader_of(self.actuator.api, self.world.sumo_ids[row], _LEADER_RANGE_M)

    def _own_headway(self, row: int) -> Headway:
        vehicle, name = self.actuator.api.vehicle, self.world.sumo_ids[row]
        return Headway(float(vehicle.getMinGap(name)), float(vehicle.getTau(name)))

    def _follows_steadily(self, row: int, leader: tuple[str, float] | None) -> bool:
        """Return whether *row* has a *leader* and does not close in on it."""
        if leader is None:
            return False
        leader_mps = float(self.actuator.api.vehicle.getSpeed(leader[0]))
        return float(self.world.speed_mps[row]) - leader_mps <= _MAX_CLOSING_MPS

    def _share(self, row: int, own: Headway, leader: tuple[str, float] | None) -> float:
        """Return the gap to *leader* as a share of the *own* headway of *row*; at most 1, and 1 without a leader."""
        if leader is None:
            return 1.0
        # SUMO's gap does not include the present gap at standstill
        gap_m = leader[1] + float(self.actuator.api.vehicle.getMinGap(self.world.sumo_ids[row]))
        own_gap_m = own.min_gap_m + own.tau_s * max(float(self.world.speed_mps[row]), 0.0)
        return min(max(gap_m / max(own_gap_m, 1e-3), _MIN_SHARE), 1.0)

    def _set(self, row: int, headway: Headway) -> None:
        vehicle, name = self.actuator.api.vehicle, self.world.sumo_ids[row]
        vehicle.setMinGap(name, headway.share * headway.min_gap_m)
        vehicle.setTau(name, max(headway.share * headway.tau_s, min(self.least_tau_s, headway.tau_s)))
        self._relaxing[row] = headway

    def _restore(self, row: int) -> None:
        self._set(row, replace(self._relaxing[row], share=1.0))
        del self._relaxing[row]
