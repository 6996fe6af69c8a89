"""Drivers that SUMO takes back nearer to their leader than they keep return to their headway by and by.

SUMO brakes such a driver at once, with up to 9 m/s², and whoever follows it runs into it. People accept a short gap and
widen it slowly: relaxation (Schakel, Knoop and van Arem 2012, doi:10.3141/2316-06, τ = 25 s).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from advdiff_sumo.sim.actuate import Actuator
from advdiff_sumo.sim.sumo_perception import leader_of
from advdiff_sumo.sim.world import World

RELAXATION_S = 25.0
_LOOKS_M = 60.0
_RELAXED = 0.98
_LEAST_SHARE = 0.05
_CLOSES_MPS = 1.0


@dataclass(frozen=True)
class Headway:
    """What a driver keeps.

    Attributes:
        min_gap_m: at standstill.
        tau_s: beyond that, in time.
        share: of both that it keeps for now.
    """

    min_gap_m: float
    tau_s: float
    share: float = 1.0


class HeadwayRelaxation:
    """The drivers of one episode whose headway is shorter than their own.

    Args:
        actuator: moves vehicles, and knows SUMO.
        world: rows and states.
        least_tau_s: shortest headway that SUMO can drive with.
    """

    def __init__(self, actuator: Actuator, world: World, least_tau_s: float) -> None:
        self.actuator, self.world, self.least_tau_s = actuator, world, least_tau_s
        self._relaxing: dict[int, Headway] = {}

    def begin(self, row: int) -> None:
        """Let *row*, which SUMO has just taken back, keep the gap that it has, if that is shorter than its own.

        Who closes up, as on somebody who stands, brakes as SUMO's driver would.
        """
        leader = self._leader(row)
        own = self._relaxing.get(row) or self._headway(row)
        share = self._share(row, own, leader) if self._follows(row, leader) else 1.0
        if share < 1.0:
            self._keep(row, replace(own, share=share))
        elif row in self._relaxing:
            self._restore(row)

    def advance(self, elapsed_s: float) -> None:
        """Bring everybody nearer to the headway of its own, *elapsed_s* after the last time."""
        for row, own in list(self._relaxing.items()):
            if row not in self.world.in_sumo:
                del self._relaxing[row]
                continue
            relaxed = own.share + (1.0 - own.share) * elapsed_s / RELAXATION_S
            share = max(relaxed, self._share(row, own, self._leader(row)))
            if row in self.actuator.moved or share >= _RELAXED:
                self._restore(row)
            else:
                self._keep(row, replace(own, share=share))

    def _leader(self, row: int) -> tuple[str, float] | None:
        return leader_of(self.actuator.api, self.world.sumo_ids[row], _LOOKS_M)

    def _headway(self, row: int) -> Headway:
        vehicle, name = self.actuator.api.vehicle, self.world.sumo_ids[row]
        return Headway(float(vehicle.getMinGap(name)), float(vehicle.getTau(name)))

    def _follows(self, row: int, leader: tuple[str, float] | None) -> bool:
        """Return whether *row* has a *leader* on whom it does not close up."""
        if leader is None:
            return False
        leads_mps = float(self.actuator.api.vehicle.getSpeed(leader[0]))
        return float(self.world.speed_mps[row]) - leads_mps <= _CLOSES_MPS

    def _share(self, row: int, own: Headway, leader: tuple[str, float] | None) -> float:
        """Return the gap to *leader* as a share of what *row* keeps of its *own*; 1 at most, and with nobody ahead."""
        if leader is None:
            return 1.0
        # SUMO tells what is left beyond the gap at standstill that holds now
        gap_m = leader[1] + float(self.actuator.api.vehicle.getMinGap(self.world.sumo_ids[row]))
        kept_m = own.min_gap_m + own.tau_s * max(float(self.world.speed_mps[row]), 0.0)
        return min(max(gap_m / max(kept_m, 1e-3), _LEAST_SHARE), 1.0)

    def _keep(self, row: int, headway: Headway) -> None:
        vehicle, name = self.actuator.api.vehicle, self.world.sumo_ids[row]
        vehicle.setMinGap(name, headway.share * headway.min_gap_m)
        vehicle.setTau(name, max(headway.share * headway.tau_s, min(self.least_tau_s, headway.tau_s)))
        self._relaxing[row] = headway

    def _restore(self, row: int) -> None:
        self._keep(row, replace(self._relaxing[row], share=1.0))
        del self._relaxing[row]
