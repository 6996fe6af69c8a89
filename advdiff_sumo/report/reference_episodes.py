"""What would have happened without attack: the same seed scene as it was logged, or in natural traffic."""

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
_KEPT_DRIVES = 16


class ReferenceEpisodes:
    """Finds the natural counterpart of each episode.

    Where seed scenes come from a driving log, it is the log itself, read again. Otherwise, in a sweep that has
    it, it is the episode with the same scene and target in SUMO's own or in replayed traffic; else the traffic
    that the seed scene was cut from, which the episode has kept.
    """

    def __init__(self, run: FinishedRun) -> None:
        self._run = run
        self._logs: dict[str, list[str]] = {}
        for net, root in run.logs():
            self._logs.setdefault(net, []).append(root)
        self._readers: dict[str, LogReader | None] = {}
        self._drive = lru_cache(maxsize=_KEPT_DRIVES)(self._read_drive)
        self._episodes = {
            (_situation(row), row["background"]): int(row["episode"])
            for row in reversed(run.episodes)
            if row["scene_key"] and row["background"] in NATURAL and row["end"] != "failed"
        }

    def of(self, row: Row) -> Tracks | None:
        """Return (A, T) natural tracks of the episode in *row*, clock 0 at its start; None when none are known."""
        for known in (self._logged, self._simulated, self._kept):
            tracks = known(row)
            if tracks is not None:
                return tracks
        return None

    def kept(self, row: Row) -> EpisodeStates | None:
        """Return the traffic that the seed scene of *row* was cut from, as the episode has kept it, or None."""
        return self._run.natural(int(row["episode"]))

    def _kept(self, row: Row) -> Tracks | None:
        """Return the same where the background was not natural itself."""
        kept = None if row["background"] == NATURAL[0] else self.kept(row)
        return None if kept is None else kept.tracks

    def drive_of(self, row: Row) -> LogScene | None:
        """Return the logged drive that the episode's seed scene was cut from; None without a log."""
        name = str(row["scene"]).rpartition("-")[0]
        drives = (self._drive(root, name) for root in self._logs.get(str(row["net"]), ()))
        return next((drive for drive in drives if drive is not None), None)

    def _logged(self, row: Row) -> Tracks | None:
        drive, now = self.drive_of(row), str(row["scene"]).rpartition("-")[2]
        if drive is None or not now.isdigit():
            return None
        tracks = drive.tracks
        return tracks.shifted(-tracks.t0_s - int(now) * tracks.dt_s)

    def _read_drive(self, root: str, name: str) -> LogScene | None:
        try:
            if root not in self._readers:
                self._readers[root] = open_log(Path(root))
            reader = self._readers[root]
            return None if reader is None else reader.read(name)
        except UnknownNameError:  # of another log, or of none
            return None
        except AdvdiffError:  # the log was moved or changed since: the page is drawn without it
            self._readers.setdefault(root, None)
            return None

    def _simulated(self, row: Row) -> Tracks | None:
        if row["background"] == NATURAL[0]:
            return None
        for background in NATURAL:
            number = self._episodes.get((_situation(row), background))
            if number is not None and background != row["background"]:
                states = self._run.states(number)
                return None if states is None else thinned(states.tracks)
        return None


def _situation(row: Mapping[str, Any]) -> tuple[str, str, str]:
    return str(row["scene_key"]), str(row["target"]), str(row["target_options"])


def thinned(tracks: Tracks) -> Tracks:
    """Return every n-th instant, so that they are about half a second apart."""
    return tracks.every(max(1, round(0.5 / tracks.dt_s)))
