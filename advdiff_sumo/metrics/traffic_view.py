"""The movements of all road users on a map, recorded or planned, on which traffic rules are checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.placement import Placement, placement_of


@dataclass(frozen=True, eq=False)
class TrafficView:
    """Tracks of all road users with their map; A agents, T instants.

    They come from a recorded episode (:meth:`of_record`) or from a plan: the histories of the last seconds, followed
    by a candidate future.

    Attributes:
        tracks: (A, T) states, in the frame of the map.
        road: the map.
        signals: T mappings, traffic light → SUMO's state string; () if unknown.
        routes: row → edges of that agent's route, if known.
    """

    tracks: Tracks
    road: RoadMap
    signals: tuple[Mapping[str, str], ...] = ()
    routes: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    _placed: dict[tuple[int, int, int], Placement] = field(default_factory=dict, init=False, repr=False)

    @staticmethod
    def of_record(record: EpisodeRecord, road: RoadMap) -> TrafficView:
        """Return the view of a recorded episode; it knows the route of the target only."""
        routes = {record.target: record.route} if record.route else {}
        return TrafficView(record.tracks, road, record.signals, routes)

    def place(self, row: int, start: int, stop: int) -> Placement:
        """Return the lanes of agent *row* at instants *start* to *stop* (exclusive); the result is cached."""
        key = (row, start, stop)
        if key not in self._placed:
            self._placed[key] = placement_of(self.road, self.tracks, row, start, stop)
        return self._placed[key]

    def steps(self, seconds: float) -> int:
        """Return the number of steps in *seconds*."""
        return round(seconds / self.tracks.dt_s)

    def time_s(self, step: int) -> float:
        """Return the time of instant *step* since the episode's start."""
        return self.tracks.t0_s + step * self.tracks.dt_s
