"""One episode of a folder with all that is needed to draw it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.metrics.severity import worst_first
from advdiff_sumo.report.blocks import departed
from advdiff_sumo.report.folder import FinishedRun, Row
from advdiff_sumo.report.layer import MapLayer, NetWindow
from advdiff_sumo.report.nets import NetLayers
from advdiff_sumo.report.reference_episodes import ReferenceEpisodes
from advdiff_sumo.report.scene_picture import ATTACKER_NEAR_M, focus_points, impact_of
from advdiff_sumo.report.select import attacker_of

_ROUNDING = 1e-6
_MARGIN_M, _LEAST_WIDTH_M = 10.0, 45.0


@dataclass(frozen=True)
class ChosenEpisode:
    """An episode that was asked for.

    Attributes:
        row: its row of ``episodes.parquet``.
        states: who was where.
        collisions: its rows of ``collisions.parquet``.
        layer: the net; None when it is not there.
        natural: what happened in its seed scene without attack, where that is known and differs.
    """

    row: Row
    states: EpisodeStates
    collisions: tuple[Row, ...]
    layer: MapLayer | None
    natural: Tracks | None

    @staticmethod
    def read(folder: Path, episode: int | None) -> ChosenEpisode:
        """Read *episode* of the run or sweep in *folder*; without a number its worst one.

        Raises:
            FileError: there is no such run, episode, or no states of it.
        """
        run = FinishedRun.read(folder)
        if episode is None and not run.episodes:
            raise FileError(folder, "has no episode", "give the folder of a finished run")
        row = worst_first(run.episodes)[0] if episode is None else run.row(episode)
        states = run.states(int(row["episode"]))
        if states is None:
            raise FileError(folder, f"holds no states of episode {row['episode']}", "choose another episode")
        natural_tracks = ReferenceEpisodes(run).of(row)
        natural = None if natural_tracks is None else departed(states, natural_tracks)
        layer = NetLayers(run).layer(str(row["net"]))
        return ChosenEpisode(row, states, run.collisions_of(int(row["episode"])), layer, natural)

    @property
    def attacker(self) -> int | None:
        """Row of the target's collision partner, or of who came nearest to it, or None."""
        name = attacker_of(self.row)
        return None if name is None else self.states.tracks.index.get(name)

    @property
    def contact_s(self) -> float | None:
        """When the target collided or left the road, or None."""
        return float(self.row["collision_time_s"]) if self.row["target_collision"] else None

    @property
    def impact_m(self) -> FloatArray | None:
        """(2,) where, or None."""
        return impact_of(self.row) if self.row["target_collision"] else None

    def span_s(self, start_s: float | None, end_s: float | None, most_s: float) -> tuple[float, float]:
        """Return the stretch to draw: as asked, else up to the contact, or 1 s beyond the least distance.

        Args:
            start_s: as asked, or None.
            end_s: as asked, or None.
            most_s: length where no start was asked.

        Raises:
            ConfigError: what was asked is not in the episode.
        """
        last = float(self.states.tracks.times_s[-1])
        if last <= 0.0 and self.row["end"] == "failed":
            raise ConfigError(f"the episode failed before it began: {self.row['failure_message']}")
        nearest = self.row["min_clearance_time_s"]
        moment = self.contact_s if self.contact_s is not None else None if nearest is None else nearest + 1.0
        end = end_s if end_s is not None else min(last, last if moment is None else float(moment))
        start = start_s if start_s is not None else max(0.0, end - most_s)
        if not 0.0 <= start < end <= last + 1e-6:
            asked = f"{start:g} to {end:g} s"
            raise ConfigError(f"{asked} is no stretch of the episode; it lasts from 0 to {last:g} s")
        return start, end

    def view(self, start_s: float, end_s: float, aspect: float) -> NetWindow:
        """Return the view of the target's way from *start_s* to *end_s*, and of the attacker's near to it."""
        steps = self.steps(start_s, end_s)
        shown = self.states.tracks.window(steps.start, steps.stop)
        points = focus_points(shown, self.states.target, self.attacker, self.impact_m)
        return NetWindow.around(points, _MARGIN_M, _LEAST_WIDTH_M, aspect)

    def view_at(self, moment_s: float, width_m: float = _LEAST_WIDTH_M) -> NetWindow:
        """Return a square view of the target at *moment_s*, and of the attacker if near, at least *width_m* wide."""
        places = poses_at(self.states.tracks, moment_s)[0]
        rows = [self.states.target] if self.attacker is None else [self.states.target, self.attacker]
        near = np.linalg.norm(places[rows] - places[self.states.target], axis=-1) <= ATTACKER_NEAR_M
        return NetWindow.around(places[rows][near], _MARGIN_M, width_m, aspect=1.0)

    def steps(self, start_s: float, end_s: float) -> slice:
        """Return the instants from *start_s* to *end_s*."""
        dt = self.states.tracks.dt_s
        return slice(round(start_s / dt), math.floor(end_s / dt + _ROUNDING) + 1)


def poses_at(tracks: Tracks, time_s: float) -> tuple[FloatArray, FloatArray]:
    """Return (A, 2) positions and (A,) headings at *time_s*, between instants in proportion; NaN when absent."""
    place = (time_s - tracks.t0_s) / tracks.dt_s
    k = int(np.clip(np.floor(place + 1e-6), 0, tracks.steps - 1))
    after, share = min(k + 1, tracks.steps - 1), float(np.clip(place - k, 0.0, 1.0))
    if share < 1e-6:
        return tracks.xy_m[:, k], tracks.yaw_rad[:, k]
    xy = (1.0 - share) * tracks.xy_m[:, k] + share * tracks.xy_m[:, after]
    turn = np.angle(np.exp(1j * (tracks.yaw_rad[:, after] - tracks.yaw_rad[:, k])))
    return xy, tracks.yaw_rad[:, k] + share * turn
