"""Computes the motion of the careful driver in the target's place, for player and charts."""

from __future__ import annotations

from dataclasses import replace

from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.near_miss import careful_driver_drive, near_miss
from advdiff_sumo.metrics.reference import ReferenceDrive, drive_reference
from advdiff_sumo.report.folder import FinishedRun, Row
from advdiff_sumo.report.stored_record import record_of_states

#: Its name in the player.
NAME = "careful driver"


def drive_of(run: FinishedRun, row: Row, states: EpisodeStates, road: RoadMap) -> ReferenceDrive | None:
    """Return the careful driver's motion from its takeover on.

    None without a collision that has a verdict and without a critical near miss.

    Args:
        run: for the states of the traffic lights.
        row: of the episode.
        states: of the episode.
        road: its map.
    """
    if row["preventable"] is None and not row["critical"]:
        return None
    record = record_of_states(states, row, run.signals(int(row["episode"])))
    if not row["critical"]:
        contact = target_collision(record, collisions(record))
        return None if contact is None else drive_reference(record, road, contact)
    critical_moment = near_miss(record, road)
    return None if critical_moment is None else careful_driver_drive(record, road, critical_moment)


def tracks_of(drive: ReferenceDrive, states: EpisodeStates) -> Tracks:
    """Return *drive* as tracks of one agent, cut to the episode's duration."""
    tracks = states.tracks
    count = min(len(drive.states.speed_mps), tracks.steps - drive.takeover_step)
    target = replace(tracks.rows([states.target]), ids=(NAME,))
    shown_states = drive.states.mapped(lambda part: part[None, :count])
    return target.with_states(shown_states, drive.takeover_step * tracks.dt_s, tracks.dt_s)
