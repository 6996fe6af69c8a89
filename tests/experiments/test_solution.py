"""Whether collisions could have been avoided: situations whose answer is plain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from advdiff_sumo.core.boxes import corners, overlap
from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.experiments.solution import SolveOptions, first_contact_step, met_by, solve
from advdiff_sumo.experiments.solution_check import BRAKES_MPS2, DELAYS_S, braked, drive, surroundings, usable
from advdiff_sumo.experiments.solvable import solvable
from advdiff_sumo.maps import RoadMap
from tests.traffic.small_networks import downtown, one_thread, weights

__all__ = ["downtown", "one_thread", "weights"]

_LENGTH_M = 4.6


def drives(road: RoadMap, vehicles: Sequence[tuple[float, float, float]], seconds: float) -> Tracks:
    """Return tracks at 10 Hz of vehicles on one long lane: (metres along it, metres to its left, speed)."""
    lanes = [x for x in road.lanes.values() if not x.is_internal and x.permits("passenger")]
    lane = max(lanes, key=lambda x: (x.length_m, x.id))
    steps = round(seconds / 0.1) + 1
    place, left, speed = (np.array(column)[:, None] for column in zip(*vehicles, strict=True))
    along = place + speed * 0.1 * np.arange(steps)
    xy, yaw = lane.line.at(along, np.broadcast_to(left, along.shape), extrapolate=True)
    count = len(vehicles)
    return Tracks(
        ids=tuple(f"v{k}" for k in range(count)),
        classes=np.zeros(count, dtype=np.int64),
        size_m=np.tile([_LENGTH_M, 1.9], (count, 1)),
        xy_m=xy,
        yaw_rad=yaw,
        speed_mps=np.broadcast_to(speed, along.shape).copy(),
        valid=np.ones(along.shape, dtype=np.bool_),
        t0_s=0.0,
        dt_s=0.1,
    )


def test_the_first_contact(downtown: RoadMap) -> None:
    """12 m apart at 10 m/s: boxes of 4.6 m have met when 7.4 m are driven, first seen at 0.8 s."""
    tracks = drives(downtown, [(20.0, 0.0, 10.0), (32.0, 0.0, 0.0)], 2.0)
    assert first_contact_step(tracks, 0) == 8
    assert first_contact_step(drives(downtown, [(20.0, 0.0, 10.0), (80.0, 0.0, 10.0)], 2.0), 0) == 20


def test_who_drives_into_a_standing_car_could_have_braked(downtown: RoadMap, weights: str) -> None:
    tracks = drives(downtown, [(20.0, 0.0, 8.0), (56.0, 0.0, 0.0)], 4.5)
    made = solve(EpisodeStates(tracks, 0), downtown, SolveOptions(weights=weights, draws=2, rounds=10))
    assert made.solvable
    assert made.states is not None
    assert (made.begin_s, made.contact_s) == (0.0, pytest.approx(4.0))
    np.testing.assert_allclose(made.states[0, :2], tracks.xy_m[0, 0])
    size = np.broadcast_to([_LENGTH_M, 1.9], (len(made.states), 2))
    mine = corners(made.states[:, :2], made.states[:, 2], size)
    other = corners(tracks.xy_m[1, :1], tracks.yaw_rad[1, :1], tracks.size_m[1:])
    assert not overlap(mine, np.broadcast_to(other, mine.shape)).any()
    assert np.diff(made.states[:, 3]).min() >= -8.0 * 0.1 - 1e-6  # no harder than the model's limits
    again = solve(EpisodeStates(tracks, 0), downtown, SolveOptions(weights=weights, draws=2, rounds=10))
    assert again.states is not None
    assert again.states.tobytes() == made.states.tobytes()


def test_nobody_gets_out_from_between_two_walls(downtown: RoadMap, weights: str) -> None:
    """Cars stand ahead and on both sides, and one comes from behind at 20 m/s, 2 m away."""
    walls = [(27.0, 0.0, 0.0), (20.0, 2.2, 0.0), (20.0, -2.2, 0.0), (13.0, 0.0, 20.0)]
    tracks = drives(downtown, [(20.0, 0.0, 0.0), *walls], 0.5)
    made = solve(EpisodeStates(tracks, 0), downtown, SolveOptions(weights=weights, draws=2, rounds=10))
    assert not made.solvable
    assert made.states is None
    assert made.free == 0
    assert made.tried == 2 * (2 + 8) + len(BRAKES_MPS2) * len(DELAYS_S)


def test_the_search_finds_what_no_start_is(downtown: RoadMap, weights: str) -> None:
    """A gap that plain manoeuvres miss: with rounds at least as many drives are free as without."""
    tracks = drives(downtown, [(20.0, 0.0, 10.0), (48.0, 0.0, 3.0), (10.0, 0.0, 9.0)], 4.0)
    episode = EpisodeStates(tracks, 0)
    none = solve(episode, downtown, SolveOptions(weights=weights, draws=2, rounds=0))
    some = solve(episode, downtown, SolveOptions(weights=weights, draws=2, rounds=30))
    assert some.free > none.free
    assert some.solvable


def test_braking_on_the_recorded_way_keeps_to_it_and_stops_where_it_must(downtown: RoadMap) -> None:
    """At 10 m/s on a quarter circle of 40 m: 5 m/s² stop it after 10 m; after a second of delay, after 20 m."""
    angle = 0.1 * 10.0 / 40.0 * np.arange(61)
    tracks = drives(downtown, [(20.0, 0.0, 10.0)], 6.0)
    tracks.xy_m[0] = 40.0 * np.stack((np.sin(angle), 1.0 - np.cos(angle)), axis=-1)
    tracks.yaw_rad[0] = angle
    accel, curvature = braked(tracks, 0, 0, 10, 0.5)
    assert accel.shape == curvature.shape == (75, 10)
    driven = drive(surroundings(tracks, 0, 0, 50), accel, curvature, 5)
    radius = np.linalg.norm(driven[..., :2] - [0.0, 40.0], axis=-1)
    np.testing.assert_allclose(radius, 40.0, atol=0.02)
    for row, metres in ((8, 10.0), (15 + 8, 20.0)):
        assert driven[row, -1, 3] == 0.0
        assert 40.0 * driven[row, -1, 2] == pytest.approx(metres, abs=0.05)


def test_the_check_sees_contact_and_the_roads_edge(downtown: RoadMap) -> None:
    """Straight on touches the car ahead; braking does not; a sharp turn leaves the road."""
    tracks = drives(downtown, [(20.0, 0.0, 8.0), (50.0, 0.0, 0.0)], 4.0)
    around = surroundings(tracks, 0, 0, 40)
    accel = np.repeat([[0.0], [-3.0], [0.0]], 8, axis=1)
    curvature = np.repeat([[0.0], [0.0], [0.09]], 8, axis=1)
    driven = drive(around, accel, curvature, 5)
    assert driven.shape == (3, 41, 4)
    assert usable(downtown, around, driven).tolist() == [False, True, False]


def test_a_third_that_runs_into_the_rear_is_no_matter(downtown: RoadMap, weights: str) -> None:
    """The car behind drives on through whoever brakes; the one ahead stands, and is met in the record."""
    tracks = drives(downtown, [(20.0, 0.0, 8.0), (56.0, 0.0, 0.0), (13.0, 0.0, 8.0)], 4.5)
    assert met_by(tracks, 0, 40) == {"v1"}
    assert met_by(tracks, 0, 10) == {"v2"}  # nobody is met yet: the nearest
    around = surroundings(tracks, 0, 0, 40)
    driven = drive(around, np.full((1, 8), -3.0), np.zeros((1, 8)), 5)
    assert not usable(downtown, around, driven).any()
    assert not usable(downtown, around, driven, {"v1", "v2"}).any()
    assert usable(downtown, around, driven, {"v1"}).all()
    assert solve(
        EpisodeStates(tracks, 0), downtown, SolveOptions(weights=weights, draws=1, rounds=0)
    ).solvable


def test_beyond_the_record_velocities_are_kept(downtown: RoadMap) -> None:
    tracks = drives(downtown, [(20.0, 0.0, 8.0), (50.0, 0.0, 5.0)], 1.0)
    around = surroundings(tracks, 0, 5, 15)
    assert around.states.shape == (1, 16, 4)
    went = np.linalg.norm(around.states[0, 15, :2] - around.states[0, 5, :2])
    assert went == pytest.approx(5.0, abs=1e-6)


def test_the_contact_may_be_given_and_nothing_before_the_target_is_there(
    downtown: RoadMap, weights: str
) -> None:
    """Boxes meet after 35.4 m, at 4.5 s; the target is there from 0.3 s on."""
    tracks = drives(downtown, [(20.0, 0.0, 8.0), (60.0, 0.0, 0.0)], 5.0)
    tracks.valid[0, :3] = False
    made = solve(EpisodeStates(tracks, 0), downtown, SolveOptions(weights=weights, draws=1, rounds=5), 45)
    assert (made.begin_s, made.contact_s) == (pytest.approx(0.3), pytest.approx(4.5))
    assert made.solvable


def test_solvable_asks_about_the_first_collision_alone(downtown: RoadMap, weights: str) -> None:
    """The car beside overlaps from the start, which counts for nothing; the one ahead could have been braked for."""
    options = SolveOptions(weights=weights, draws=1, rounds=5)
    record = record_of_tracks(drives(downtown, [(20.0, 0.0, 8.0), (56.0, 0.0, 0.0), (19.0, 1.0, 0.0)], 4.5))
    assert solvable(record, downtown, options) is True
    far = record_of_tracks(drives(downtown, [(20.0, 0.0, 8.0), (80.0, 0.0, 8.0)], 2.0))
    assert solvable(far, downtown, options) is None


def record_of_tracks(tracks: Tracks) -> EpisodeRecord:
    return EpisodeRecord(
        episode=0,
        seed=0,
        scene="",
        tracks=tracks,
        target=0,
        controller=np.where(tracks.valid, Controller.SUMO, Controller.ABSENT).astype(np.int64),
        route=(),
        end=EndReason.HORIZON,
        signals=(),
    )
