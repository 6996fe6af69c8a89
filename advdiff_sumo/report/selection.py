"""Reads one episode of a folder with all data that are needed to draw it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.report.blocks import deviating_tracks
from advdiff_sumo.report.folder import FinishedRun, Row
from advdiff_sumo.report.layer import MapLayer, NetWindow
from advdiff_sumo.report.nets import NetLayers
from advdiff_sumo.report.reference_episodes import ReferenceEpisodes
from advdiff_sumo.report.scene_picture import ATTACKER_NEAR_M, focus_points, impact_of
from advdiff_sumo.report.select import attacker_of, nearest_s

_ROUNDING = 1e-6
_MARGIN_M, _LEAST_WIDTH_M = 10.0, 45.0


@dataclass(frozen=True)
class ChosenEpisode:
    """The episode to draw.

    Attributes:
        row: its row of ``episodes.parquet``.
        states: its states.
        collisions: its rows of ``collisions.parquet``.
        layer: the net; None if it is missing.
        natural: tracks in its seed scene without attack, of the target and of those that differ; None if unknown.
    """

    row: Row
    states: EpisodeStates
    collisions: tuple[Row, ...]
    layer: MapLayer | None
    natural: Tracks | None

    @staticmethod
    def read(folder: Path, episode: int | None) -> ChosenEpisode:
        """Read *episode* of the run or sweep in *folder*; None: its worst one.

        Raises:
            FileError: there is no such run, episode, or no states of it.
        """
        run = FinishedRun.read(folder)
        row = run.worst_row() if episode is None else run.row(episode)
        states = run.states(int(row["episode"]))
        if states is None:
            raise FileError(folder, f"holds no states of episode {row['episode']}", "choose another episode")
        natural_tracks = ReferenceEpisodes(run).natural_tracks(row)
        natural = None if natural_tracks is None else deviating_tracks(states, natural_tracks)
        layer = NetLayers(run).layer(str(row["net"]))
        return ChosenEpisode(row, states, run.collisions_of(int(row["episode"])), layer, natural)

    @property
    def attacker(self) -> int | None:
        """Row of the partner of the collision or critical near miss, else of who came nearest, or None."""
        name = attacker_of(self.row)
        return None if name is None else self.states.tracks.index.get(name)

    @property
    def contact_s(self) -> float | None:
        """Time at which the target collided or left the road, or None."""
        return float(self.row["collision_time_s"]) if self.row["target_collision"] else None

    @property
    def impact_m(self) -> FloatArray | None:
        """(2,) place at which the target collided or left the road, or None."""
        return impact_of(self.row) if self.row["target_collision"] else None

    def span_s(self, start_s: float | None, end_s: float | None, most_s: float) -> tuple[float, float]:
        """Return begin and end of the span to draw.

        Args:
            start_s: requested begin; None: *most_s* before the end.
            end_s: requested end; None: the contact, 1 s after the near miss or least distance, or the episode's end.
            most_s: longest duration without a requested begin.

        Raises:
            ConfigError: the requested span is not in the episode.
        """
        last_s = float(self.states.tracks.times_s[-1])
        if last_s <= 0.0 and self.row["end"] == "failed":
            raise ConfigError(f"the episode failed before it began: {self.row['failure_message']}")
        nearest = nearest_s(self.row)
        after_nearest_s = None if nearest is None else nearest + 1.0
        event_s = self.contact_s if self.contact_s is not None else after_nearest_s
        end = end_s if end_s is not None else min(last_s, last_s if event_s is None else float(event_s))
        start = start_s if start_s is not None else max(0.0, end - most_s)
        if not 0.0 <= start < end <= last_s + 1e-6:
            requested = f"{start:g} to {end:g} s"
            raise ConfigError(f"{requested} is no stretch of the episode; it lasts from 0 to {last_s:g} s")
        return start, end

    def view(self, start_s: float, end_s: float, aspect: float) -> NetWindow:
        """Return the view of the target's path from *start_s* to *end_s*, and of the attacker's near it."""
        steps = self.steps(start_s, end_s)
        tracks = self.states.tracks.window(steps.start, steps.stop)
        points = focus_points(tracks, self.states.target, self.attacker, self.impact_m)
        return NetWindow.around(points, _MARGIN_M, _LEAST_WIDTH_M, aspect)

    def view_at(self, moment_s: float, width_m: float = _LEAST_WIDTH_M) -> NetWindow:
        """Return a square view of the target at *moment_s*, and of the attacker if near, at least *width_m* wide."""
        xy_m = poses_at(self.states.tracks, moment_s)[0]
        rows = [self.states.target] if self.attacker is None else [self.states.target, self.attacker]
        is_near = np.linalg.norm(xy_m[rows] - xy_m[self.states.target], axis=-1) <= ATTACKER_NEAR_M
        return NetWindow.around(xy_m[rows][is_near], _MARGIN_M, width_m, aspect=1.0)

    def steps(self, start_s: float, end_s: float) -> slice:
        """Return the instants from *start_s* to *end_s*."""
        dt = self.states.tracks.dt_s
        return slice(round(start_s / dt), math.floor(end_s / dt + _ROUNDING) + 1)


def poses_at(tracks: Tracks, time_s: float) -> tuple[FloatArray, FloatArray]:
    """Return positions (A, 2) and headings (A,) at *time_s*, interpolated linearly; NaN for absent agents."""
    step = (time_s - tracks.t0_s) / tracks.dt_s
    k = int(np.clip(np.floor(step + 1e-6), 0, tracks.steps - 1))
    next_step, share = min(k + 1, tracks.steps - 1), float(np.clip(step - k, 0.0, 1.0))
    if share < 1e-6:
        return tracks.xy_m[:, k], tracks.yaw_rad[:, k]
    xy = (1.0 - share) * tracks.xy_m[:, k] + share * tracks.xy_m[:, next_step]
    yaw_change = np.angle(np.exp(1j * (tracks.yaw_rad[:, next_step] - tracks.yaw_rad[:, k])))
    return xy, tracks.yaw_rad[:, k] + share * yaw_change
