"""Vehicles that appear or leave by a policy's plan, worked by hand and in a running simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.record import Controller
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.entries import completed, have_room, presence
from advdiff_sumo.sim.seed_scene import SeedScene
from tests.sim.scenes import episode


def tracks_at(valid: list[bool], x_m: list[float]) -> Tracks:
    """One vehicle that drives east at 4 m/s."""
    steps = len(x_m)
    known = np.array([valid])
    xy = np.stack((np.array([x_m]), np.zeros((1, steps))), axis=-1)
    gaps = np.where(known, 1.0, np.nan)
    return Tracks(
        ids=("new",),
        classes=np.zeros(1, dtype=np.int64),
        size_m=np.array([[4.5, 1.8]]),
        xy_m=xy * gaps[..., None],
        yaw_rad=0.0 * gaps,
        speed_mps=4.0 * gaps,
        valid=known,
        t0_s=0.5,
        dt_s=0.5,
    )


NOWHERE = np.full((1, 2), np.nan), np.full(1, np.nan), np.full(1, np.nan)


def test_an_absent_vehicle_approaches_along_its_first_heading() -> None:
    now, plan = completed(tracks_at([True, True], [12.0, 14.0]), NOWHERE)
    assert now[0].tolist() == [[10.0, 0.0]]
    assert now[2].tolist() == [4.0]
    assert plan[0][0, :, 0].tolist() == [12.0, 14.0]


def test_a_plan_that_begins_late_or_ends_early_is_completed() -> None:
    now, plan = completed(tracks_at([False, True, True, False], [0.0, 12.0, 14.0, 0.0]), NOWHERE)
    assert now[0].tolist() == [[8.0, 0.0]]
    assert plan[0][0, :, 0].tolist() == [10.0, 12.0, 14.0, 16.0]


def test_a_present_vehicle_without_a_valid_state_leaves_at_once() -> None:
    tracks = tracks_at([False, False], [0.0, 0.0])
    here = np.array([[5.0, 0.0]]), np.zeros(1), np.array([2.0])
    _, plan = completed(tracks, here)
    assert plan[0][0, :, 0].tolist() == [6.0, 7.0]
    assert not presence(tracks, np.array([False]), 0.1, 5).any()


def test_presence_by_the_step() -> None:
    """The plan's instants are 0.5 and 1 s from now; present vehicles stay until their last one, new ones wait."""
    both, first = tracks_at([True, True], [12.0, 14.0]), tracks_at([True, False], [12.0, 0.0])
    there, new = np.array([False]), np.array([True])
    assert presence(both, there, 0.25, 4).tolist() == [[True] * 4]
    assert presence(both, new, 0.25, 4).tolist() == [[False, True, True, True]]
    assert presence(first, there, 0.25, 4).tolist() == [[True, True, False, False]]


@pytest.mark.parametrize(
    ("behind_m", "heading_rad", "speed_mps", "room"),
    [
        (9.9, 0.0, 0.0, False),
        (10.1, 0.0, 0.0, True),
        (79.9, 0.0, 20.0, False),  # 10 m, a second and 20² / (2 · 4) m
        (80.1, 0.0, 20.0, True),
        (-12.0, 0.0, 20.0, True),  # it has passed
        (12.0, np.pi, 20.0, True),  # it drives in the opposite direction
        (np.nan, np.nan, np.nan, True),
    ],
)
def test_a_vehicle_appears_only_where_followers_can_still_brake(
    behind_m: float, heading_rad: float, speed_mps: float, room: bool
) -> None:
    """A vehicle is to appear at the origin, standing and facing east."""
    new = np.zeros((1, 2)), np.zeros(1), np.zeros(1)
    other = np.array([[-behind_m, 0.0]]), np.array([heading_rad]), np.array([speed_mps])
    assert have_room(new, other).tolist() == [room]


class Arrival:
    """A vehicle appears at the first plan, 40 m ahead of the target on the line of its heading, and leaves at 2 s."""

    def __init__(self, exact: bool) -> None:
        self.exact = exact

    def start(
        self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator
    ) -> tuple[np.ndarray, float]:
        """Return position and heading at 0 s, those of the lane there."""
        now, row = scene.history, scene.target
        here = road.locate(now.xy_m[row, -1], float(now.yaw_rad[row, -1]))
        assert here is not None
        xy, yaw = road.lanes[here.lane_id].line.at(here.s_m + 40.0, extrapolate=True)
        return xy, float(yaw)

    def plan(
        self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator
    ) -> tuple[JointPlan, Any]:
        """Return two seconds at 5 m/s straight on, as long as the vehicle is present."""
        times = scene.time_s + 0.5 * np.arange(1.0, 5.0)
        there = times <= 2.0
        gaps = np.where(there, 1.0, np.nan)
        heading = np.array((np.cos(memory[1]), np.sin(memory[1])))
        tracks = Tracks(
            ids=("newcomer",),
            classes=np.zeros(1, dtype=np.int64),
            size_m=np.array([[4.5, 1.8]]),
            xy_m=((memory[0] + 5.0 * times[:, None] * heading) * gaps[:, None])[None],
            yaw_rad=(memory[1] * gaps)[None],
            speed_mps=(5.0 * gaps)[None],
            valid=there[None],
            t0_s=scene.time_s + 0.5,
            dt_s=0.5,
        )
        return JointPlan(tracks, exact=self.exact), memory


@pytest.mark.parametrize("exact", [False, True])
def test_a_policy_brings_a_vehicle_in_and_takes_it_away(scene: SeedScene, road: RoadMap, exact: bool) -> None:
    """Also in traffic of SUMO's demand, where SUMO inserts vehicles of its own."""
    record, _ = episode(scene, road, background=Arrival(exact), horizon_s=4.0).run()
    assert record.failure is None
    row = record.tracks.index["newcomer"]
    there = np.flatnonzero(record.tracks.valid[row])
    assert (there[0], there[-1]) == (5, 20)
    assert (record.controller[row, there] == Controller.POLICY).all()
    assert np.isfinite(record.tracks.xy_m[row, there]).all()
    assert record.tracks.speed_mps[row, there] == pytest.approx(5.0, abs=0.3)
    assert record.refused_insertions == 0


class OutOfSight(Arrival):
    """A vehicle that appears where another one is, ``ahead_m`` further on than the target."""

    def __init__(self, ahead_m: float) -> None:
        super().__init__(exact=False)
        self.ahead_m = ahead_m

    def start(
        self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator
    ) -> tuple[np.ndarray, float]:
        """Return the position of the vehicle that is nearest to ``ahead_m`` from the target."""
        assert log is not None
        now = log.xy_m[:, 0]
        apart = np.linalg.norm(now - now[log.index[scene.target_id]], axis=-1)
        row = int(np.nanargmin(np.abs(apart - self.ahead_m)))
        return now[row], float(log.yaw_rad[row, 0])


def test_no_vehicle_appears_out_of_sight_on_top_of_another_one(scene: SeedScene, road: RoadMap) -> None:
    """The policy sees 20 m. Its vehicle 60 m away is left out, and the episode continues."""
    made = episode(scene, road, background=OutOfSight(60.0), horizon_s=2.0, observe_radius_m=20.0)
    record, _ = made.run()
    assert record.failure is None
    assert "newcomer" not in record.tracks.index
