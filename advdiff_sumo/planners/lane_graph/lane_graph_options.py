"""Options of the lane-graph planner."""

from __future__ import annotations

from pydantic import Field

from advdiff_sumo.config import Options


class LaneGraphOptions(Options):
    """How the lane-graph planner drives.

    Attributes:
        speed_factor: desired speed divided by the lane's limit.
        time_headway_s: time gap to a leader (IDM's T).
        min_gap_m: gap to a leader at standstill (IDM's s0).
        stop_gap_m: gap between front bumper and stop line.
        accel_mps2: strongest acceleration (IDM's a).
        decel_mps2: comfortable deceleration (IDM's b).
        brake_mps2: deceleration of the emergency candidate, and the strongest of all.
        jerk_mps3: largest change of acceleration per second outside emergencies.
        lateral_mps2: lateral acceleration that limits the speed in bends.
        lane_change_s: duration of a lane change.
        horizon_s: duration over which candidates are checked.
        gap_s: time gap to keep to a vehicle with the right of way.
        margin_m: two footprints with less clearance count as a collision.
        courtesy_m: clearance below which a candidate costs more.
        lane_changes: whether it changes lanes to go faster; it always makes the lane changes that its route needs.
        patience_s: after waiting so long it no longer yields to vehicles that stand, too.
    """

    speed_factor: float = Field(1.0, gt=0.0, le=2.0)
    time_headway_s: float = Field(1.2, gt=0.0, le=5.0)
    min_gap_m: float = Field(2.0, ge=0.5, le=10.0)
    stop_gap_m: float = Field(1.0, ge=0.0, le=5.0)
    accel_mps2: float = Field(2.0, gt=0.0, le=4.0)
    decel_mps2: float = Field(2.5, gt=0.0, le=6.0)
    brake_mps2: float = Field(8.0, gt=0.0, le=9.0)
    jerk_mps3: float = Field(6.0, gt=0.0)
    lateral_mps2: float = Field(2.5, gt=0.0, le=6.0)
    lane_change_s: float = Field(4.0, gt=1.0, le=10.0)
    horizon_s: float = Field(5.0, ge=3.0, le=8.0)
    gap_s: float = Field(1.2, ge=0.0, le=5.0)
    margin_m: float = Field(0.2, ge=0.0, le=2.0)
    courtesy_m: float = Field(0.6, ge=0.0, le=3.0)
    lane_changes: bool = True
    patience_s: float = Field(3.0, gt=0.0)
