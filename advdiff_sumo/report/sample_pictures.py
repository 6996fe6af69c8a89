"""How fast, how hard and how near: values of many episodes, to hold against natural traffic."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.metrics.criticality import TTC_HORIZON_S, time_to_collision
from advdiff_sumo.report.folder import FinishedRun, Row
from advdiff_sumo.report.labels import Labels
from advdiff_sumo.report.reference_episodes import NATURAL, ReferenceEpisodes, thinned

#: Episodes looked at for each background, evenly spaced over all of them.
MOST_EPISODES = 150
LOGGED = "driving log"
SCENES = "traffic of the seed scenes"
_MOVES_MPS = 0.5


@dataclass(frozen=True)
class Samples:
    """Values every 0.5 s.

    Attributes:
        speed_mps: of the background vehicles that ever move.
        accel_mps2: of the same, as differences of their speeds.
        ttc_s: least time to collision of the target, where it is under 10 s.
        episodes: how many they come from.
    """

    speed_mps: FloatArray
    accel_mps2: FloatArray
    ttc_s: FloatArray
    episodes: int

    @staticmethod
    def joined(parts: Sequence[Samples]) -> Samples:
        """Return all of *parts* as one."""
        nothing = np.zeros(0)
        return Samples(
            speed_mps=np.concatenate([nothing, *(p.speed_mps for p in parts)]),
            accel_mps2=np.concatenate([nothing, *(p.accel_mps2 for p in parts)]),
            ttc_s=np.concatenate([nothing, *(p.ttc_s for p in parts)]),
            episodes=sum(p.episodes for p in parts),
        )


def samples_of(tracks: Tracks, target: int) -> Samples:
    """Return the samples of one episode or drive; *target* is the row of the tested vehicle."""
    thin = thinned(tracks)
    speed = thin.speed_mps
    moves = np.nanmax(np.where(thin.valid, speed, -np.inf), axis=1, initial=-np.inf) > _MOVES_MPS
    moves &= thin.classes != AgentClass.PEDESTRIAN
    moves[target] = False
    accel = np.diff(speed[moves], axis=1) / thin.dt_s
    ttc = time_to_collision(thin, target)
    least = np.where(np.isfinite(ttc), ttc, np.inf).min(axis=0, initial=np.inf)
    return Samples(
        speed_mps=speed[moves][thin.valid[moves]],
        accel_mps2=accel[np.isfinite(accel)],
        ttc_s=least[least <= TTC_HORIZON_S],
        episodes=1,
    )


def samples_by_background(
    run: FinishedRun, naturals: ReferenceEpisodes, labels: Labels
) -> Mapping[str, Samples]:
    """Return the samples of each background, natural traffic first: SUMO's own, or the log behind the scenes.

    Where nothing was run in SUMO's own traffic, it is the traffic that the seed scenes were cut from.
    """
    groups: dict[str, list[Row]] = {}
    for row in run.episodes:
        if row["end"] != "failed":
            groups.setdefault(labels.background(row), []).append(row)
    samples = {name: Samples.joined(list(_driven(run, _spaced(rows)))) for name, rows in groups.items()}
    logged = Samples.joined(list(_logged(naturals, _spaced(run.episodes))))
    first = {LOGGED: logged} if logged.episodes else {}
    if not first and all(row["background"] != NATURAL[0] for row in run.episodes):
        kept = Samples.joined(list(_kept(naturals, _spaced(run.episodes))))
        first = {SCENES: kept} if kept.episodes else {}
    ordered = sorted(samples, key=lambda name: (NATURAL[0] not in name.split(), name))
    return first | {name: samples[name] for name in ordered if samples[name].episodes}


def _driven(run: FinishedRun, rows: Iterable[Row]) -> Iterable[Samples]:
    for row in rows:
        states = run.states(int(row["episode"]))
        if states is not None:
            yield samples_of(states.tracks, states.target)


def _logged(naturals: ReferenceEpisodes, rows: Iterable[Row]) -> Iterable[Samples]:
    drives = {(str(row["net"]), str(row["scene"]).rpartition("-")[0]): row for row in rows}
    for row in drives.values():
        drive = naturals.drive_of(row)
        if drive is not None:
            yield samples_of(drive.tracks, drive.ego)


def _kept(naturals: ReferenceEpisodes, rows: Iterable[Row]) -> Iterable[Samples]:
    scenes = {(str(row["net"]), str(row["scene_key"]), str(row["scene"])): row for row in rows}
    for row in scenes.values():
        kept = naturals.kept(row)
        if kept is not None:
            yield samples_of(kept.tracks, kept.target)


def _spaced(rows: Sequence[Row]) -> list[Row]:
    if not rows:
        return []
    chosen = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), MOST_EPISODES)).round().astype(int))
    return [rows[k] for k in chosen]
