"""Why nobody was in a position to attack in an episode, as far as its record tells."""

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
    AS_GOOD_AS_STANDS_MPS,
    BEHIND_M,
    BESIDE_M,
    IN_LANE_M,
    LEADS_M,
    SAME_WAY,
    STOPPING_KINDS,
    STOPS_FROM_MPS,
)

_SHORT_S = 6.0
"""Who has come in drives ordinarily at first."""
_BRIEF_S = 10.0
"""Leaders first open or close the gap, so that this may be too short, too, where nothing else was lacking."""
_FROM_AHEAD = ("hard-stop", "blocked-lane", "stop-and-go", "cut-out")


def lacking(attack: str, row: Mapping[str, Any], states: EpisodeStates) -> str:
    """Return what an episode lacked in which nobody was in a position for *attack*, in words.

    Args:
        attack: its kind.
        row: of ``episodes``.
        states: of the episode.
    """
    reasons = [*_of_target(states), *_of_others(attack, states), *_of_time(row, _SHORT_S)]
    reasons = reasons or [*_of_time(row, _BRIEF_S)]
    return in_series(reasons) if reasons else "the record does not tell what was lacking"


def _of_target(states: EpisodeStates) -> Iterator[str]:
    fastest = float(np.nanmax(states.tracks.speed_mps[states.target]))
    if fastest < AS_GOOD_AS_STANDS_MPS:
        yield "the target stood"
    elif fastest < SLOWEST_TARGET_MPS:
        yield f"the target drove at most {fastest:.1f} m/s"


def _of_others(attack: str, states: EpisodeStates) -> Iterator[str]:
    ahead, beside = _places(states)
    if attack in _FROM_AHEAD and not ahead.any():
        yield f"nobody was straight ahead of it within {LEADS_M:g} m"
    elif attack in STOPPING_KINDS:
        fastest = float(states.tracks.speed_mps[ahead].max())
        if fastest <= STOPS_FROM_MPS:
            yield f"who was ahead of it drove at most {fastest:.1f} m/s"
    elif attack == "cut-in" and not beside.any():
        yield f"nobody drove beside it within {AHEAD_M:g} m"


def _places(states: EpisodeStates) -> tuple[BoolArray, BoolArray]:
    """Return (A, T) who was ahead in the target's lane, and who on a lane beside, as if the road went straight on."""
    tracks, target = states.tracks, states.target
    yaw = tracks.yaw_rad[target]
    place = local_from_world(tracks.xy_m, tracks.xy_m[target], yaw)
    along, aside = place[..., 0], np.abs(place[..., 1])
    same = np.cos(tracks.yaw_rad - yaw) > SAME_WAY
    same[target] = False
    ahead = same & (along > 0.0) & (along < LEADS_M) & (aside < IN_LANE_M)
    near = same & (along > BEHIND_M) & (along < AHEAD_M)
    return ahead, near & (aside > IN_LANE_M) & (aside < BESIDE_M)


def _of_time(row: Mapping[str, Any], least_s: float) -> Iterator[str]:
    if row["duration_s"] < least_s:
        why = "--horizon" if row["end"] == EndReason.HORIZON else row["end"]
        yield f"the episode lasted {row['duration_s']:.1f} s ({why})"
