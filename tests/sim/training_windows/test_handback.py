"""Traffic that a model drives for a while, and then SUMO's drivers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data.window_files import FUTURE, PAST
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.training_windows.handback import drive_in_turn, recording_of
from advdiff_sumo.sim.training_windows.simulation_run import Recording, cut
from tests.sim.scenes import episode

_BRAKES_MPS2 = 3.0


class StopsForGood:
    """Brakes all vehicles to a standstill and keeps them there, as a bad model does."""

    def start(self, *_: Any) -> None:
        """Remember nothing."""

    def plan(
        self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator
    ) -> tuple[JointPlan, None]:
        """Return 6 s of braking straight on."""
        now = scene.history.rows(np.flatnonzero(scene.movable))
        t_s = np.arange(1, 13) * now.dt_s
        begin = now.speed_mps[:, -1:]
        speed = np.maximum(begin - _BRAKES_MPS2 * t_s, 0.0)
        way = (begin**2 - speed**2) / (2.0 * _BRAKES_MPS2)
        yaw = np.repeat(now.yaw_rad[:, -1:], 12, axis=1)
        along = np.stack((np.cos(yaw), np.sin(yaw)), axis=-1)
        xy = now.xy_m[:, -1:] + way[..., None] * along
        there = np.ones_like(speed, dtype=np.bool_)
        tracks = Tracks(
            now.ids, now.classes, now.size_m, xy, yaw, speed, there, scene.time_s + now.dt_s, now.dt_s
        )
        return JointPlan(tracks), None


@pytest.fixture(scope="module")
def recording(road: RoadMap, scene: SeedScene) -> Recording:
    """One turn of the policy of 8 s, and one of SUMO's drivers."""
    return drive_in_turn(road, scene, SeedTree(5), StopsForGood(), 1.0, (8.0, 8.0))


def test_windows_begin_where_sumo_takes_over_and_shortly_later(
    recording: Recording, scene: SeedScene
) -> None:
    handback = scene.history.steps - 1 + round(8.0 / 0.5)
    assert recording.instants == (handback, handback + 2, handback + 4)
    assert len(recording.signals) == recording.tracks.steps == handback + 4 + FUTURE + 1
    for now in recording.instants:
        focal = recording.focal[:, now]
        assert focal.any()
        assert recording.tracks.valid[focal, now].all()
        assert not recording.expert[focal, handback].any()  # their present states result from the policy
    assert not recording.focal[:, handback - 1].any()


def test_windows_show_vehicles_that_a_model_has_stopped_start_again(recording: Recording) -> None:
    handback = recording.instants[0]
    stood = recording.focal[:, handback] & (recording.tracks.speed_mps[:, handback] < 0.2)
    led = stood & recording.expert[:, handback + 1 : handback + 1 + FUTURE].all(axis=1)
    assert led.sum() >= 2
    xy = recording.tracks.xy_m[led]
    driven = np.linalg.norm(xy[:, handback + FUTURE] - xy[:, handback], axis=-1)
    assert np.median(driven) > 10.0


def test_futures_end_where_nobody_but_sumo_drives(recording: Recording, road: RoadMap) -> None:
    windows = list(cut(recording, road.pieces("far"), SeedTree(1), "a"))
    assert windows
    known = np.concatenate([window.future_valid for window in windows])
    assert known.any(axis=1).mean() > 0.5
    assert not known.all()  # states that result from the model are no future to learn
    assert (known[:, :-1] >= known[:, 1:]).all()  # nothing is valid after a gap
    assert all(window.past_valid[0, -PAST:].all() for window in windows)
    assert all((window.future[~window.future_valid] == 0.0).all() for window in windows)


def test_a_turn_of_sumo_that_ends_early_has_fewer_instants(road: RoadMap, scene: SeedScene) -> None:
    made = episode(scene, road, background=StopsForGood(), horizon_s=8.0)
    with made.opened() as loop:
        loop.start()
        loop.run(40)
        last = len(loop.recorder.model_frames) - 1
        ended = recording_of(loop, [last - 3])
    assert ended.instants == ()
    assert ended.focal[:, last - 3].any()
    assert ended.focal.shape[1] == last + 1


def test_the_same_seed_gives_the_same_traffic(recording: Recording, road: RoadMap, scene: SeedScene) -> None:
    again = drive_in_turn(road, scene, SeedTree(5), StopsForGood(), 1.0, (8.0, 8.0))
    np.testing.assert_array_equal(again.tracks.xy_m, recording.tracks.xy_m)
    np.testing.assert_array_equal(again.expert, recording.expert)
