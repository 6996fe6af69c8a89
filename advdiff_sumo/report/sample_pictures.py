"""Collects speeds, accelerations and times to collision of many episodes, to compare them with natural traffic."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.metrics.criticality import TTC_HORIZON_S, time_to_collision
from advdiff_sumo.report.folder import FinishedRun, Row
from advdiff_sumo.report.labels import Labels
from advdiff_sumo.report.reference_episodes import NATURAL, ReferenceEpisodes, thinned_tracks

#: Number of episodes used for each background, evenly spaced over all of them.
MOST_EPISODES = 150
LOG_LABEL = "driving log"
SEED_TRAFFIC_LABEL = "traffic of the seed scenes"
_MOVING_MPS = 0.5


@dataclass(frozen=True)
class Samples:
    """Values every 0.5 s.

    Attributes:
        speed_mps: of the background vehicles that move at any time.
        accel_mps2: of the same, as differences of their speeds.
        ttc_s: least time to collision of the target, where it is at most 10 s.
        episodes: number of episodes.
    """

    speed_mps: FloatArray
    accel_mps2: FloatArray
    ttc_s: FloatArray
    episodes: int

    @staticmethod
    def joined(parts: Sequence[Samples]) -> Samples:
        """Return *parts* concatenated."""
        empty = np.zeros(0)
        return Samples(
            speed_mps=np.concatenate([empty, *(p.speed_mps for p in parts)]),
            accel_mps2=np.concatenate([empty, *(p.accel_mps2 for p in parts)]),
            ttc_s=np.concatenate([empty, *(p.ttc_s for p in parts)]),
            episodes=sum(p.episodes for p in parts),
        )


def samples_of(tracks: Tracks, target: int) -> Samples:
    """Return the samples of one episode or drive; *target* is the row of the tested vehicle."""
    thin = thinned_tracks(tracks)
    speed = thin.speed_mps
    is_moving = np.nanmax(np.where(thin.valid, speed, -np.inf), axis=1, initial=-np.inf) > _MOVING_MPS
    is_moving &= thin.classes != AgentClass.PEDESTRIAN
    is_moving[target] = False
    accel = np.diff(speed[is_moving], axis=1) / thin.dt_s
    ttc = time_to_collision(thin, target)
    least_ttc_s = np.where(np.isfinite(ttc), ttc, np.inf).min(axis=0, initial=np.inf)
    return Samples(
        speed_mps=speed[is_moving][thin.valid[is_moving]],
        accel_mps2=accel[np.isfinite(accel)],
        ttc_s=least_ttc_s[least_ttc_s <= TTC_HORIZON_S],
        episodes=1,
    )


def samples_by_background(
    run: FinishedRun, naturals: ReferenceEpisodes, labels: Labels
) -> Mapping[str, Samples]:
    """Return the samples of each background, natural traffic first.

    The driving log of the seed scenes comes before all, if there is one. Without log and episodes in SUMO's own
    traffic, the recorded traffic of the seed scenes takes its place.
    """
    groups: dict[str, list[Row]] = {}
    for row in run.episodes:
        if row["end"] != "failed":
            groups.setdefault(labels.background(row), []).append(row)
    samples = {
        name: Samples.joined(list(_driven_samples(run, _evenly_spaced(rows))))
        for name, rows in groups.items()
    }
    logged = Samples.joined(list(_logged_samples(naturals, _evenly_spaced(run.episodes))))
    natural = {LOG_LABEL: logged} if logged.episodes else {}
    if not natural and all(row["background"] != NATURAL[0] for row in run.episodes):
        seed_traffic = Samples.joined(list(_seed_traffic_samples(naturals, _evenly_spaced(run.episodes))))
        natural = {SEED_TRAFFIC_LABEL: seed_traffic} if seed_traffic.episodes else {}
    ordered = sorted(samples, key=lambda name: (NATURAL[0] not in name.split(), name))
    return natural | {name: samples[name] for name in ordered if samples[name].episodes}


def _driven_samples(run: FinishedRun, rows: Iterable[Row]) -> Iterable[Samples]:
    for row in rows:
        states = run.states(int(row["episode"]))
        if states is not None:
            yield samples_of(states.tracks, states.target)


def _logged_samples(naturals: ReferenceEpisodes, rows: Iterable[Row]) -> Iterable[Samples]:
    drives = {(str(row["net"]), str(row["scene"]).rpartition("-")[0]): row for row in rows}
    for row in drives.values():
        drive = naturals.logged_drive(row)
        if drive is not None:
            yield samples_of(drive.tracks, drive.ego)


def _seed_traffic_samples(naturals: ReferenceEpisodes, rows: Iterable[Row]) -> Iterable[Samples]:
    scenes = {(str(row["net"]), str(row["scene_key"]), str(row["scene"])): row for row in rows}
    for row in scenes.values():
        traffic = naturals.seed_traffic(row)
        if traffic is not None:
            yield samples_of(traffic.tracks, traffic.target)


def _evenly_spaced(rows: Sequence[Row]) -> list[Row]:
    if not rows:
        return []
    indices = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), MOST_EPISODES)).round().astype(int))
    return [rows[k] for k in indices]
