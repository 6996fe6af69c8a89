"""Define what an episode starts from, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.scene import Tracks


@dataclass(frozen=True)
class SavedTraffic:
    """Running SUMO traffic, saved at the scene's first instant.

    Attributes:
        state_xml: SUMO's saved state.
        time_s: SUMO's clock in it.
        routes: contents of the demand files from which SUMO continues to insert vehicles.
        additional: contents of the files with vehicle types, signals and stops that the demand needs.
    """

    state_xml: bytes
    time_s: float
    routes: tuple[bytes, ...] = ()
    additional: tuple[bytes, ...] = ()


@dataclass(frozen=True)
class PlacedTraffic:
    """Vehicles of a driving log, placed at their logged poses; there are no others.

    Attributes:
        drivable: (A,) agents that SUMO may drive: on a lane of the net and along it, not parked, no pedestrian.
    """

    drivable: BoolArray


@dataclass(frozen=True)
class SeedScene:
    """The net, the histories and the route from which an episode starts; time 0 is its first instant.

    Attributes:
        name: unique in its source.
        net: the net file.
        seed: SUMO's seed.
        history: (A, H) states at the model step; the last instant is 0.
        target: id of the vehicle that the tested planner replaces.
        routes: id → edges from the present one on, if known.
        log: (A', T) states of all road users from instant 0 on, in natural traffic or the driving log.
        start: how SUMO is brought to instant 0.
        horizon_s: duration of the log; episodes in which the log moves vehicles may not be longer.
    """

    name: str
    net: Path
    seed: int
    history: Tracks
    target: str
    routes: Mapping[str, tuple[str, ...]]
    log: Tracks
    start: SavedTraffic | PlacedTraffic
    horizon_s: float
