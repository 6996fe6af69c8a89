"""Runs the clairvoyant search for a recorded collision, for its verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING

from advdiff_sumo.core.errors import SceneError
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.collision import collisions, target_collision

if TYPE_CHECKING:
    from advdiff_sumo.experiments.solution import SolveOptions


def solvable(record: EpisodeRecord, road: RoadMap, options: SolveOptions | None = None) -> bool | None:
    """Return whether the search finds a trajectory that avoids the target's first collision with a road user.

    None if there is no such collision, or if the time step of the record does not fit the networks of the search.

    Args:
        record: the episode.
        road: its map.
        options: of the search.

    Raises:
        WeightsError: the networks are missing or unusable.
    """
    from advdiff_sumo.experiments.solution import solve  # late: verdicts without it need no PyTorch

    collision = target_collision(record, collisions(record))
    if collision is None:
        return None
    contact = min(collision.step + (collision.fraction > 0.0), record.tracks.steps - 1)
    try:
        return solve(EpisodeStates(record.tracks, record.target), road, options, contact).solvable
    except SceneError:
        return None
