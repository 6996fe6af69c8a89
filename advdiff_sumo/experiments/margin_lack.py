"""Explains from an episode's record why no vehicle was in a position to attack."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.frames import local_from_world
from advdiff_sumo.core.record import EndReason
from advdiff_sumo.core.wording import in_series
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.traffic.manoeuvres.priority_traffic import SLOWEST_TARGET_MPS
from advdiff_sumo.traffic.manoeuvres.repertoire import (
    AHEAD_M,
    BEHIND_M,
    BESIDE_M,
    IN_LANE_M,
    LEADER_RANGE_M,
    MIN_HEADING_COSINE,
    MIN_STOPPING_SPEED_MPS,
    SLOW_ENTRIES,
    STANDING_BELOW_MPS,
    STOPPING_KINDS,
)
from advdiff_sumo.traffic.manoeuvres.slow_places import SLOW_ENTRY_MIN_MPS

_LEAD_IN_S = 6.0
"""Inserted vehicles drive without attacking at first: shorter episodes leave no time for an attack."""
_SHORT_EPISODE_S = 10.0
"""Leaders adjust their gap before they attack: an episode below this may be too short, if nothing else explains it."""
_BY_LEADER = ("hard-stop", "blocked-lane", "stop-and-go", "cut-out")


def lack_text(attack: str, row: Mapping[str, Any], states: EpisodeStates) -> str:
    """Return in words why no vehicle was in a position for *attack* in an episode.

    Args:
        attack: its kind.
        row: of the episode in ``episodes``.
        states: of the episode.
    """
    reasons = [
        *_target_reasons(attack, states),
        *_traffic_reasons(attack, states),
        *_duration_reasons(row, _LEAD_IN_S),
    ]
    reasons = reasons or [*_duration_reasons(row, _SHORT_EPISODE_S)]
    return in_series(reasons) if reasons else "the record does not tell what was lacking"


def _target_reasons(attack: str, states: EpisodeStates) -> Iterator[str]:
    fastest = float(np.nanmax(states.tracks.speed_mps[states.target]))
    if fastest < STANDING_BELOW_MPS:
        yield "the target stood"
    elif fastest < (SLOW_ENTRY_MIN_MPS if attack in SLOW_ENTRIES else SLOWEST_TARGET_MPS):
        yield f"the target drove at most {fastest:.1f} m/s"


def _traffic_reasons(attack: str, states: EpisodeStates) -> Iterator[str]:
    ahead, beside = _ahead_and_beside(states)
    if attack in _BY_LEADER and not ahead.any():
        yield f"nobody was straight ahead of it within {LEADER_RANGE_M:g} m"
    elif attack in STOPPING_KINDS:
        fastest = float(states.tracks.speed_mps[ahead].max())
        if fastest <= MIN_STOPPING_SPEED_MPS:
            yield f"who was ahead of it drove at most {fastest:.1f} m/s"
    elif attack in ("cut-in", *SLOW_ENTRIES) and not beside.any():
        yield f"nobody drove beside it within {AHEAD_M:g} m"


def _ahead_and_beside(states: EpisodeStates) -> tuple[BoolArray, BoolArray]:
    """Return which vehicles (A, T) were ahead in the target's lane and which beside it, assuming a straight road."""
    tracks, target = states.tracks, states.target
    yaw = tracks.yaw_rad[target]
    offset = local_from_world(tracks.xy_m, tracks.xy_m[target], yaw)
    along_m, aside_m = offset[..., 0], np.abs(offset[..., 1])
    same_direction = np.cos(tracks.yaw_rad - yaw) > MIN_HEADING_COSINE
    same_direction[target] = False
    ahead = same_direction & (along_m > 0.0) & (along_m < LEADER_RANGE_M) & (aside_m < IN_LANE_M)
    is_near = same_direction & (along_m > BEHIND_M) & (along_m < AHEAD_M)
    return ahead, is_near & (aside_m > IN_LANE_M) & (aside_m < BESIDE_M)


def _duration_reasons(row: Mapping[str, Any], least_s: float) -> Iterator[str]:
    if row["duration_s"] < least_s:
        end = "--horizon" if row["end"] == EndReason.HORIZON else row["end"]
        yield f"the episode lasted {row['duration_s']:.1f} s ({end})"
