"""Replay follows the log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError, SceneError
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.data.nuscenes import NuScenesReader
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.run_episodes import RunOptions, policy_of
from advdiff_sumo.traffic.replay import Replay

RNG = np.random.default_rng(0)


def test_the_plan_is_the_log_from_the_next_step_on(road: RoadMap, scene: Scene, log: Tracks) -> None:
    policy = Replay(period_s=3.0)
    plan, memory = policy.plan(road, scene, policy.start(road, scene, log, RNG), RNG)
    tracks = plan.tracks
    assert plan.exact
    assert tracks.ids == ("a", "b", "c")  # no target, no unmovable "d", no "flash"
    assert (tracks.t0_s, tracks.dt_s, tracks.steps) == (0.1, 0.1, 30)
    t = tracks.times_s
    np.testing.assert_allclose(tracks.xy_m[0, :, 0], 10.0 * t)
    np.testing.assert_array_equal(tracks.valid[1], t < 1.05)
    np.testing.assert_array_equal(tracks.valid[2], t > 1.95)
    np.testing.assert_allclose(tracks.speed_mps[2][tracks.valid[2]], 20.0)
    assert memory.t0_s == 0.0


@pytest.mark.parametrize(
    ("sim", "period_s", "step_s"),
    [
        ({}, 1.0, 0.1),
        ({"replan_every": 3}, 1.5, 0.1),
        ({"model_step_s": 2.0}, 2.0, 0.1),
        ({"step_s": 0.05}, 1.0, 0.05),
    ],
)
def test_in_a_run_plans_reach_to_the_next_plan_at_sumos_steps(
    sim: dict[str, float], period_s: float, step_s: float
) -> None:
    made = policy_of(RunOptions.parse({"background": "replay", "sim": sim}))
    assert isinstance(made, Replay)
    assert (made.options.period_s, made.options.step_s) == (period_s, step_s)
    own = RunOptions.parse({"background": "replay", "background_options": {"period_s": 4.0}, "sim": sim})
    chosen = policy_of(own)
    assert isinstance(chosen, Replay)
    assert chosen.options.period_s == 4.0


def test_a_vehicle_of_the_scene_whose_log_ended_leaves(road: RoadMap, scene: Scene, log: Tracks) -> None:
    policy = Replay()
    memory = policy.start(road, scene, log, RNG)
    later = Scene(scene.history.shifted(1.5), scene.target, scene.movable, scene.routes, {})
    tracks = policy.plan(road, later, memory, RNG)[0].tracks
    assert not tracks.valid[tracks.index["b"]].any()
    assert tracks.valid[tracks.index["a"]].all()


@pytest.mark.parametrize(("now_s", "share"), [(5.5, 0.5), (6.0, 0.0), (9.0, 0.0), (-0.9, 0.2)])
def test_beyond_the_log_no_vehicle_is_valid(
    road: RoadMap, scene: Scene, log: Tracks, now_s: float, share: float
) -> None:
    policy = Replay()
    memory = policy.start(road, scene, log, RNG)  # from 0 to 6 s
    moved = Scene(scene.history.shifted(now_s), scene.target, scene.movable, scene.routes, {})
    tracks = policy.plan(road, moved, memory, RNG)[0].tracks
    assert tracks.steps == 10
    assert tracks.valid[tracks.index["a"]].mean() == pytest.approx(share)


def test_times_between_the_steps_of_the_log(road: RoadMap, scene: Scene, log: Tracks) -> None:
    policy = Replay()
    memory = policy.start(road, scene, log, RNG)
    moved = Scene(scene.history.shifted(0.03), scene.target, scene.movable, scene.routes, {})
    tracks = policy.plan(road, moved, memory, RNG)[0].tracks
    np.testing.assert_allclose(tracks.xy_m[0, :, 0], 10.0 * (0.03 + 0.1 * np.arange(1, 11)))


def test_it_does_not_react_to_the_target(road: RoadMap, scene: Scene, log: Tracks) -> None:
    policy = Replay()
    memory = policy.start(road, scene, log, RNG)
    before = policy.plan(road, scene, memory, RNG)[0].tracks.xy_m
    scene.history.xy_m[scene.target] = scene.history.xy_m[1] + [5.0, 0.0]
    np.testing.assert_array_equal(policy.plan(road, scene, memory, RNG)[0].tracks.xy_m, before)


def test_impossible_options_and_missing_logs_are_refused(road: RoadMap, scene: Scene) -> None:
    with pytest.raises(SceneError, match="needs a log"):
        Replay().start(road, scene, None, RNG)
    with pytest.raises(ConfigError, match="did you mean 'step_s'"):
        Replay(steps=0.1)
    with pytest.raises(ConfigError, match="period_s"):
        Replay(period_s=0.0)


@pytest.mark.data
def test_real_drives_are_followed_at_every_keyframe(road: RoadMap, adv_data: Path) -> None:
    """Replan every 0.5 s over whole scenes, as the simulation does, and compare with the log."""
    policy = Replay()
    for drive in NuScenesReader(adv_data / "nuscenes-mini").scenes():
        log, compared = drive.tracks.shifted(-2.0), 0
        memory = None
        for k in range(4, log.steps - 1):
            history = log.window(k - 4, k + 1).rows(log.valid[:, k])
            scene = Scene(
                history,
                history.index["ego"],
                np.ones(history.agents, dtype=np.bool_),
                ((),) * history.agents,
                {},
            )
            memory = policy.start(road, scene, log, RNG) if memory is None else memory
            tracks = policy.plan(road, scene, memory, RNG)[0].tracks
            assert "ego" not in tracks.ids
            rows = [log.index[name] for name in tracks.ids]
            there = tracks.valid[:, 4]
            lone = log.valid[rows, k + 1] & ~there
            for row in np.flatnonzero(lone):  # only vehicles logged at this keyframe alone may be missing
                assert not log.valid[rows[row], [k, min(k + 2, log.steps - 1)]].any()
            np.testing.assert_array_equal(tracks.xy_m[there, 4], log.xy_m[rows, k + 1][there])
            turn = wrap_angle(tracks.yaw_rad[there, 4] - log.yaw_rad[rows, k + 1][there])
            assert np.abs(turn).max(initial=0.0) < 1e-12
            compared += int(there.sum())
        assert compared > 0.9 * (log.valid[1:, 5:].sum() - log.agents)
