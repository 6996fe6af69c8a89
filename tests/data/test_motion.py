"""What stands in a log stands still when it is read; worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.motion import parked_agents, without_jitter

DT = 0.5


def tracks_of(x_m: list[list[float]], classes: list[AgentClass]) -> Tracks:
    """Return agents that face east at (*x_m*, 3 · row)."""
    x = np.array(x_m)
    xy = np.stack((x, np.repeat(3.0 * np.arange(len(x))[:, None], x.shape[1], axis=1)), axis=-1)
    speed = np.gradient(x, DT, axis=1)
    return Tracks(
        ids=tuple(map(str, range(len(x)))),
        classes=np.array(classes),
        size_m=np.tile((4.5, 1.8), (len(x), 1)),
        xy_m=xy,
        yaw_rad=np.tile(0.02 * np.sin(np.arange(x.shape[1])), (len(x), 1)),
        speed_mps=speed,
        valid=np.isfinite(x),
        t0_s=0.0,
        dt_s=DT,
    )


def stilled(tracks: Tracks) -> Tracks:
    return without_jitter(tracks, parked_agents(tracks.xy_m, tracks.valid, DT), 0)


DRIFTS = [0.0, 0.2, 0.4, 0.7, 0.5, 0.8, 0.7, 0.9]
DRIVES = [0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 28.0]


def test_a_parked_car_keeps_its_median_place_heading_and_no_speed() -> None:
    made = stilled(tracks_of([DRIVES, DRIFTS], [AgentClass.CAR] * 2))
    assert (made.xy_m[1] == (0.6, 3.0)).all()
    assert len(set(made.yaw_rad[1].tolist())) == 1
    assert (made.speed_mps[1] == 0.0).all()


def test_the_ego_and_who_drives_stay_as_they_are() -> None:
    tracks = tracks_of([DRIFTS, DRIVES], [AgentClass.CAR] * 2)
    made = stilled(tracks)
    np.testing.assert_array_equal(made.xy_m, tracks.xy_m)
    np.testing.assert_array_equal(made.speed_mps, tracks.speed_mps)


def test_a_pedestrian_who_takes_a_step_is_not_held_for_a_parked_car() -> None:
    tracks = tracks_of([DRIVES, DRIFTS], [AgentClass.CAR, AgentClass.PEDESTRIAN])
    np.testing.assert_array_equal(stilled(tracks).xy_m[1], tracks.xy_m[1])


def test_a_stop_at_a_light_is_one_place_from_arrival_to_start() -> None:
    """Arrives at 10 m, wanders by 6 cm for 3 s, which would read as reversing, and starts."""
    stop = [0.0, 4.0, 8.0, 10.0, 10.06, 10.0, 9.94, 10.02, 10.0, 10.2, 11.5, 14.0]
    drives = [4.0 * k for k in range(len(stop))]
    tracks = tracks_of([drives, stop], [AgentClass.CAR] * 2)
    assert (tracks.speed_mps[1] < -0.01).any()
    made = stilled(tracks)
    assert made.xy_m[1, 3:9, 0] == pytest.approx([10.0] * 6)
    assert (made.speed_mps[1, 3:9] == 0.0).all()
    assert made.xy_m[1, :3, 0].tolist() == stop[:3]
    assert made.xy_m[1, 9:, 0].tolist() == stop[9:]


def test_who_creeps_is_not_held() -> None:
    creep = [0.1 * k for k in range(24)]
    drives = [4.0 * k for k in range(24)]
    tracks = tracks_of([drives, [10.0 + x for x in creep]], [AgentClass.CAR] * 2)
    np.testing.assert_array_equal(stilled(tracks).xy_m[1], tracks.xy_m[1])


def test_instants_without_an_annotation_stay_without() -> None:
    gap = [*DRIFTS[:3], np.nan, *DRIFTS[4:]]
    made = stilled(tracks_of([DRIVES, gap], [AgentClass.CAR] * 2))
    assert np.isnan(made.xy_m[1, 3, 0])
    assert made.valid[1].tolist() == [True] * 3 + [False] + [True] * 4
