"""Finds the natural counterpart of an episode: the same seed scene in the driving log or in natural traffic."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import AdvdiffError, UnknownNameError
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data import open_log
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.data.log_reader import LogReader, LogScene
from advdiff_sumo.report.folder import FinishedRun, Row

#: Backgrounds that do not attack, the more natural one first.
NATURAL = ("sumo", "replay")
_CACHED_DRIVES = 16


class ReferenceEpisodes:
    """Finds the natural counterpart of each episode.

    It is the first available one of these:

    1. the driving log from which the seed scene comes, read again;
    2. the sweep's episode with the same scene and target in SUMO's own or in replayed traffic;
    3. the traffic from which the seed scene was taken, as recorded with the episode.
    """

    def __init__(self, run: FinishedRun) -> None:
        self._run = run
        self._logs: dict[str, list[str]] = {}
        for net, root in run.logs():
            self._logs.setdefault(net, []).append(root)
        self._readers: dict[str, LogReader | None] = {}
        self._drive = lru_cache(maxsize=_CACHED_DRIVES)(self._read_drive)
        self._episodes = {
            (_scene_and_target(row), row["background"]): int(row["episode"])
            for row in reversed(run.episodes)
            if row["scene_key"] and row["background"] in NATURAL and row["end"] != "failed"
        }

    def natural_tracks(self, row: Row) -> Tracks | None:
        """Return natural tracks (A, T) for the episode in *row*, with time 0 at its start; None if there are none."""
        for source in (self._logged_tracks, self._simulated_tracks, self._seed_traffic_tracks):
            tracks = source(row)
            if tracks is not None:
                return tracks
        return None

    def seed_traffic(self, row: Row) -> EpisodeStates | None:
        """Return the recorded traffic from which the seed scene of *row* was taken; None if it was not recorded."""
        return self._run.natural(int(row["episode"]))

    def _seed_traffic_tracks(self, row: Row) -> Tracks | None:
        """Return the tracks of ``seed_traffic``; None if the background was natural itself."""
        traffic = None if row["background"] == NATURAL[0] else self.seed_traffic(row)
        return None if traffic is None else traffic.tracks

    def logged_drive(self, row: Row) -> LogScene | None:
        """Return the logged drive from which the episode's seed scene was taken; None without a log."""
        name = str(row["scene"]).rpartition("-")[0]
        drives = (self._drive(root, name) for root in self._logs.get(str(row["net"]), ()))
        return next((drive for drive in drives if drive is not None), None)

    def _logged_tracks(self, row: Row) -> Tracks | None:
        drive, start_step = self.logged_drive(row), str(row["scene"]).rpartition("-")[2]
        if drive is None or not start_step.isdigit():
            return None
        tracks = drive.tracks
        return tracks.shifted(-tracks.t0_s - int(start_step) * tracks.dt_s)

    def _read_drive(self, root: str, name: str) -> LogScene | None:
        try:
            if root not in self._readers:
                self._readers[root] = open_log(Path(root))
            reader = self._readers[root]
            return None if reader is None else reader.read(name)
        except UnknownNameError:  # the drive is not in this log
            return None
        except AdvdiffError:  # the log was moved or changed: the page is made without it
            self._readers.setdefault(root, None)
            return None

    def _simulated_tracks(self, row: Row) -> Tracks | None:
        if row["background"] == NATURAL[0]:
            return None
        for background in NATURAL:
            number = self._episodes.get((_scene_and_target(row), background))
            if number is not None and background != row["background"]:
                states = self._run.states(number)
                return None if states is None else thinned_tracks(states.tracks)
        return None


def _scene_and_target(row: Mapping[str, Any]) -> tuple[str, str, str]:
    return str(row["scene_key"]), str(row["target"]), str(row["target_options"])


def thinned_tracks(tracks: Tracks) -> Tracks:
    """Return every n-th instant, so that instants are about 0.5 s apart."""
    return tracks.every(max(1, round(0.5 / tracks.dt_s)))
