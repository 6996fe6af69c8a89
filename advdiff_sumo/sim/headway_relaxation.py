"""Drivers that SUMO takes back nearer to their leader than they keep return to their headway by and by.

SUMO brakes such a driver at once, with up to 7 m/s², and whoever follows it runs into it. People accept a short gap and
widen it slowly: relaxation (Schakel, Knoop and van Arem 2012, doi:10.3141/2316-06, τ = 25 s).
"""

from __future__ import annotations

from dataclasses import dataclass

from advdiff_sumo.sim.actuate import Actuator
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
    """

    min_gap_m: float
    tau_s: float

    def gap_m(self, speed_mps: float) -> float:
        """Return the gap that is kept at a speed."""
        return self.min_gap_m + self.tau_s * speed_mps


@dataclass
class HeadwayRelaxation:
    """The drivers of one episode whose headway is shorter than their own.

    Attributes:
        actuator: moves vehicles, and knows SUMO.
        world: rows and states.
        least_tau_s: shortest headway that SUMO can drive with.
    """

    actuator: Actuator
    world: World
    least_tau_s: float

    def __post_init__(self) -> None:
        """Begin with nobody."""
        self._usual: dict[int, Headway] = {}
        self._share: dict[int, float] = {}

    def begin(self, row: int) -> None:
        """Let *row*, which SUMO has just taken back, keep the gap that it has, if that is shorter than its own.

        Who closes up, as on somebody who stands, brakes as SUMO's driver would.
        """
        share = self._present_share(row) if self._follows(row) else 1.0
        if share < 1.0:
            self._set(row, share)
        elif row in self._usual:
            self._forget(row)

    def advance(self, elapsed_s: float) -> None:
        """Bring everybody nearer to the headway of its own, *elapsed_s* after the last time."""
        for row in list(self._usual):
            if row not in self.world.in_sumo:
                del self._usual[row], self._share[row]
                continue
            old = self._share[row]
            share = max(old + (1.0 - old) * elapsed_s / RELAXATION_S, self._present_share(row))
            if row in self.actuator.moved or share >= _RELAXED:
                self._forget(row)
            else:
                self._set(row, share)

    def _follows(self, row: int) -> bool:
        vehicle = self.actuator.api.vehicle
        leader = vehicle.getLeader(self.world.sumo_ids[row], _LOOKS_M)
        if not leader or not leader[0]:
            return False
        return bool(float(self.world.speed_mps[row]) - float(vehicle.getSpeed(leader[0])) <= _CLOSES_MPS)

    def _present_share(self, row: int) -> float:
        """Return the gap to the leader as a share of the gap that *row* keeps; 1 at most, and with nobody ahead."""
        vehicle, name = self.actuator.api.vehicle, self.world.sumo_ids[row]
        leader = vehicle.getLeader(name, _LOOKS_M)
        if not leader or not leader[0]:
            return 1.0
        now_m = float(vehicle.getMinGap(name))
        usual = self._usual.setdefault(row, Headway(now_m, float(vehicle.getTau(name))))
        gap_m = float(leader[1]) + now_m  # SUMO tells what is left beyond the gap at standstill
        kept_m = usual.gap_m(max(float(self.world.speed_mps[row]), 0.0))
        return min(max(gap_m / max(kept_m, 1e-3), _LEAST_SHARE), 1.0)

    def _set(self, row: int, share: float) -> None:
        vehicle, name, usual = self.actuator.api.vehicle, self.world.sumo_ids[row], self._usual[row]
        vehicle.setMinGap(name, share * usual.min_gap_m)
        vehicle.setTau(name, max(share * usual.tau_s, min(self.least_tau_s, usual.tau_s)))
        self._share[row] = share

    def _forget(self, row: int) -> None:
        self._set(row, 1.0)
        del self._usual[row], self._share[row]
