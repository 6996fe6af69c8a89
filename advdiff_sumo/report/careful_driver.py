"""What the careful and competent driver would have done in the target's place, for player and charts."""

from __future__ import annotations

from dataclasses import replace

from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.near_miss import careful_drive, near_miss
from advdiff_sumo.metrics.reference import ReferenceDrive, drive_reference
from advdiff_sumo.report.folder import FinishedRun, Row
from advdiff_sumo.report.stored_record import record_of_states

#: Its name in the player.
NAME = "careful driver"


def drive_of(run: FinishedRun, row: Row, states: EpisodeStates, road: RoadMap) -> ReferenceDrive | None:
    """Return the drive from its takeover on; None where there is no verdict, or no collision or critical near miss.

    Args:
        run: for what the traffic lights showed.
        row: of the episode.
        states: of the episode.
        road: its map.
    """
    if row["preventable"] is None and not row["critical"]:
        return None
    record = record_of_states(states, row, run.signals(int(row["episode"])))
    if not row["critical"]:
        hit = target_collision(record, collisions(record))
        return None if hit is None else drive_reference(record, road, hit)
    missed = near_miss(record, road)
    return None if missed is None else careful_drive(record, road, missed)


def tracks_of(drive: ReferenceDrive, states: EpisodeStates) -> Tracks:
    """Return the drive as tracks of one agent, cut to the episode."""
    driven = states.tracks
    count = min(len(drive.states.speed_mps), driven.steps - drive.takeover_step)
    target = replace(driven.rows([states.target]), ids=(NAME,))
    shown = drive.states.mapped(lambda part: part[None, :count])
    return target.driving(shown, drive.takeover_step * driven.dt_s, driven.dt_s)
