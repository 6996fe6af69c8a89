"""Closed-loop episodes on the shipped downtown, with the real SUMO."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.frames import bumper_from_centre, unit, wrap_angle, yaw_from_sumo
from advdiff_sumo.core.plan import Controls, JointPlan, Trajectory
from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.defects.actuation import WeakBrakes
from advdiff_sumo.planners.defects.defective_planner import with_defects
from advdiff_sumo.planners.planner_protocol import Planner, SumoDriver
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.target import PlannerDrive
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from tests.sim.scenes import StraightOn, episode, running


def continuous(record: EpisodeRecord, slack_m: float = 0.6, slack_rad: float = 0.35) -> None:
    """Assert that no vehicle jumps: driven by SUMO, moved, or when handed over."""
    tracks = record.tracks
    both = tracks.valid[:, 1:] & tracks.valid[:, :-1]
    stride = np.linalg.norm(np.diff(tracks.xy_m, axis=1), axis=-1)
    expected = np.maximum(np.abs(tracks.speed_mps[:, 1:]), np.abs(tracks.speed_mps[:, :-1])) * tracks.dt_s
    assert (stride[both] <= expected[both] + slack_m).all()
    assert (np.abs(wrap_angle(np.diff(tracks.yaw_rad, axis=1)))[both] <= slack_rad).all()


def test_a_sumo_driven_episode_begins_at_the_scene_and_lasts_its_horizon(
    scene: SeedScene, road: RoadMap
) -> None:
    record, timing = episode(scene, road).run()
    assert record.end == EndReason.HORIZON
    assert record.tracks.steps == 51
    assert record.tracks.ids[record.target] == scene.target
    assert record.teleports == 0
    assert timing.wall_s > 0.0
    for name in set(record.tracks.ids) & set(scene.history.ids):
        start = record.tracks.xy_m[record.tracks.index[name], 0]
        np.testing.assert_allclose(start, scene.history.xy_m[scene.history.index[name], -1], atol=1e-6)
    assert set(np.unique(record.controller)) <= {Controller.ABSENT, Controller.SUMO}
    continuous(record)


def test_a_sumo_driver_reports_what_it_sees_and_a_planner_does_not(scene: SeedScene, road: RoadMap) -> None:
    record, _ = episode(scene, road, horizon_s=1.0).run()
    assert record.visible is not None
    assert len(record.visible) == record.tracks.steps
    assert set().union(*record.visible) - {scene.target}
    record, timing = episode(scene, road, target="lane_graph", horizon_s=1.0).run()
    assert record.visible is None
    assert len(timing.target_plans_s) == 2
    assert timing.background_plans_s == ()  # SUMO drives, there are no plans


def test_signals_are_those_of_the_episodes_own_net(scene: SeedScene, road: RoadMap, networks: Path) -> None:
    mirrored = RoadMap.read(networks / "downtown-left.net.xml")
    options = SceneOptions.parse({"warmup_s": 15.0, "scenes_per_warmup": 1})
    elsewhere = NaturalTraffic(mirrored, None, options, SimOptions.parse({}), 1.0, SeedTree(3)).batch(0)[0]
    for start, net in ((elsewhere, mirrored), (scene, road)):
        record, _ = episode(start, net, horizon_s=0.5).run()
        lights = {link.tls_id for link in net.links.values()} - {None}
        assert all(states.keys() == lights for states in record.signals)


def test_the_driver_model_makes_a_difference(scene: SeedScene, road: RoadMap) -> None:
    cautious = SumoDriver("IDM", params={"tau": 3.0, "speedFactor": 0.5})
    brisk = SumoDriver("IDM", params={"tau": 0.8, "speedFactor": 1.2})
    slow, fast = (episode(scene, road, target=driver).run()[0] for driver in (cautious, brisk))
    assert np.nanmean(slow.tracks.speed_mps[slow.target]) < np.nanmean(fast.tracks.speed_mps[fast.target])


def test_a_lane_change_model_without_sublanes_needs_them_off(scene: SeedScene, road: RoadMap) -> None:
    driver = SumoDriver("IDM", lane_change="LC2013")
    with pytest.raises(ConfigError, match="lateral_resolution_m = 0"):
        episode(scene, road, target=driver).run()
    record, _ = episode(scene, road, target=driver, horizon_s=1.0, lateral_resolution_m=0.0).run()
    assert record.end == EndReason.HORIZON


def test_replay_follows_the_log_in_the_record_and_in_sumo(
    scene: SeedScene, road: RoadMap, tmp_path: Path
) -> None:
    with running(episode(scene, road, background="replay", horizon_s=6.0), tmp_path) as loop:
        loop.run(40)
        world, api = loop.world, loop.api
        rows = np.array(sorted(row for row, moved in loop.actuator.moved.items() if moved.inserted))
        shown = np.array([api.vehicle.getPosition(world.sumo_ids[row]) for row in rows])
        turned = yaw_from_sumo(np.array([api.vehicle.getAngle(world.sumo_ids[row]) for row in rows]))
        ours = bumper_from_centre(world.xy_m[rows], world.yaw_rad[rows], world.size_m[rows, 0])
        record = loop.record(EndReason.HORIZON, None)
    assert len(rows) >= 5
    np.testing.assert_allclose(shown, ours, atol=1e-6)
    np.testing.assert_allclose(wrap_angle(turned - world.yaw_rad[rows]), 0.0, atol=1e-6)
    moved = (record.controller == Controller.POLICY).any(axis=1)
    for row in np.flatnonzero(moved):
        name = record.tracks.ids[row]
        log = scene.log.index[name]
        there = record.tracks.valid[row] & scene.log.valid[log, : record.tracks.steps]
        gap = record.tracks.xy_m[row, there] - scene.log.xy_m[log, : record.tracks.steps][there]
        assert np.abs(gap).max() < 1e-6


def test_vehicles_are_taken_over_and_handed_back_without_a_jump(scene: SeedScene, road: RoadMap) -> None:
    policy = StraightOn(until_s=1.0)
    record, _ = episode(scene, road, background=policy, control_radius_m=40.0, horizon_s=8.0).run()
    assert record.failure is None
    who = record.controller
    assert ((who[:, 1:] == Controller.POLICY) & (who[:, :-1] == Controller.SUMO)).any()
    assert ((who[:, 1:] == Controller.SUMO) & (who[:, :-1] == Controller.POLICY)).any()
    continuous(record)


def test_a_moved_vehicle_keeps_the_route_that_sumo_had_for_it(
    scene: SeedScene, road: RoadMap, tmp_path: Path
) -> None:
    """This route differs from the seed scene's for vehicles that were inserted or departed later."""
    with running(episode(scene, road, background=StraightOn(), control_radius_m=60.0), tmp_path) as loop:
        vehicle, given = loop.api.vehicle, {}
        for name in scene.history.ids:
            here = vehicle.getRoute(name)[vehicle.getRouteIndex(name)]
            onward = road.random_route(here, 300.0, np.random.default_rng(7)) or ()
            if name != scene.target and len(onward) > 2 and vehicle.getRoadID(name) == here:
                vehicle.setRoute(name, onward)
                given[name] = onward
        loop.run(6)
        taken = {loop.world.ids[row] for row in loop.actuator.moved} & given.keys()
        assert len(taken) >= 2
        for name in taken:
            row = loop.world.index[name]
            assert loop.handover.route(row, {}) == given[name][-len(loop.handover.route(row, {})) :]
            assert len(loop.handover.route(row, {})) > 1


def test_a_target_off_its_route_has_the_edges_ahead_as_its_route_in_sumo(
    scene: SeedScene, road: RoadMap, tmp_path: Path
) -> None:
    with running(episode(scene, road, target="lane_graph"), tmp_path) as loop:
        assert isinstance(loop.drive, PlannerDrive)
        here = loop.drive.route[0]
        loop.drive.route = ("R4_E4_out-E4",)
        loop.api.vehicle.setRoute(
            scene.target, (here,)
        )  # as SUMO does when the target is on an edge that is on no route
        loop.run(11)
        vehicle = loop.api.vehicle
        ahead = vehicle.getRoute(scene.target)[vehicle.getRouteIndex(scene.target) :]
        assert ahead[0] == here
        assert len(ahead) > 1
        assert ahead[1] in road.edges[here].successors


def test_a_plan_must_reach_to_the_next_one(scene: SeedScene, road: RoadMap) -> None:
    """Half a second is long enough with a plan every model step, but not with one every second model step."""
    short = Braking()
    for every, end in ((1, EndReason.HORIZON), (2, EndReason.FAILED)):
        record, _ = episode(scene, road, target=short, horizon_s=2.0, replan_every=every).run()
        assert record.end == end
    assert record.failure is not None
    assert record.failure.kind == "plan_refused"
    said = "it lasts 0.5 s, less than the 1 s to the next plan (sim.replan_every = 2 model steps of 0.5 s)"
    assert said in record.failure.message


def test_a_target_sees_as_far_with_replay_as_with_every_background(
    scene: SeedScene, road: RoadMap, tmp_path: Path
) -> None:
    for background in ("sumo", "replay"):
        made = episode(scene, road, target="lane_graph", background=background, observe_radius_m=40.0)
        with running(made, tmp_path) as loop:
            seen = loop._seen_by_target(loop.scene_now())
        xy = seen.history.xy_m[:, -1]
        assert len(xy) > 1
        assert np.linalg.norm(xy - xy[seen.target], axis=-1).max() <= 40.0


class Braking:
    """A target whose plans are half a second long."""

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> None:
        """Nothing to remember."""

    def plan(
        self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator
    ) -> tuple[Controls, None]:
        """Brake gently."""
        return Controls(np.full(5, -0.5), np.zeros(5), 0.1), None


class AsLongAsItMust(Braking):
    """Brakes until the next plan."""

    def plan(
        self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator
    ) -> tuple[Controls, None]:
        return Controls(np.full(1, -1.0), np.zeros(1), scene.least_plan_s), None


class JumpsLater(Braking):
    """Keeps its speed, from 1 s on along a line 3 m ahead of where it is."""

    def plan(
        self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator
    ) -> tuple[Trajectory, None]:
        now, row = scene.history, scene.target
        yaw, speed = np.full(10, now.yaw_rad[row, -1]), np.full(10, now.speed_mps[row, -1])
        ahead_m = speed * 0.1 * np.arange(1, 11) + 3.0 * (scene.time_s >= 1.0)
        return Trajectory(now.xy_m[row, -1] + ahead_m[:, None] * unit(yaw), yaw, speed, 0.1), None


def test_the_first_plan_that_no_vehicle_can_drive_is_recorded_with_its_time(
    scene: SeedScene, road: RoadMap
) -> None:
    record, _ = episode(scene, road, target=JumpsLater(), horizon_s=2.0).run()
    assert record.implausible == (2, "step 0 moves farther than its speeds allow (plan of 1.0 s)")


@pytest.mark.parametrize("target", [AsLongAsItMust(), with_defects(AsLongAsItMust(), (WeakBrakes(2.5),))])
def test_a_planner_knows_how_long_its_plan_must_be(scene: SeedScene, road: RoadMap, target: Planner) -> None:
    for every in (1, 3):
        record, _ = episode(scene, road, target=target, horizon_s=3.0, replan_every=every).run()
        assert record.end is EndReason.HORIZON


def test_the_policy_moves_only_what_is_near_the_target(scene: SeedScene, road: RoadMap) -> None:
    record, _ = episode(scene, road, background=StraightOn(), control_radius_m=25.0, horizon_s=3.0).run()
    tracks = record.tracks
    begun = (record.controller[:, 1:] == Controller.POLICY) & (record.controller[:, :-1] == Controller.SUMO)
    gap = np.linalg.norm(tracks.xy_m - tracks.xy_m[record.target], axis=-1)
    assert (gap[:, :-1][begun] <= 25.0 + 1e-9).all()


def test_inside_a_junction_no_vehicle_is_handed_over(scene: SeedScene, road: RoadMap, tmp_path: Path) -> None:
    """Even beyond all radii, a moved vehicle there stays with the policy, which sees the vehicles around it."""
    radii = {"control_radius_m": 5.0, "observe_radius_m": 10.0, "record_radius_m": 10.0}
    with running(episode(scene, road, horizon_s=8.0, **radii), tmp_path) as loop:
        world, rows = loop.world, np.zeros(0, dtype=np.int64)
        for steps in range(1, 81):
            loop.run(steps)
            inner = [name in road.lanes and road.lanes[name].is_internal for name in world.lane]
            gap = np.linalg.norm(world.xy_m[: len(world)] - world.xy_m[loop.target], axis=-1)
            rows = np.flatnonzero(np.array(inner) & (gap > 10.0))
            if len(rows):
                break
        row = int(rows[0])
        assert world.ids[row] not in loop.scene_now().history.ids
        loop.actuator.take(row)
        now = loop.scene_now()
        offset = world.xy_m[: len(world)] - world.xy_m[row]
        ahead = offset @ unit(world.yaw_rad[row]) >= -10.0
        around = (np.linalg.norm(offset, axis=-1) <= 40.0) & ahead
        assert {world.ids[other] for other in np.flatnonzero(around)} <= set(now.history.ids)
        assert [now.history.ids[k] for k in np.flatnonzero(now.movable)] == [world.ids[row]]


class FarthestSeen(StraightOn):
    """Traffic that drives straight on, and records the largest distance from the target at which it sees a vehicle."""

    farthest_m = 0.0

    def plan(self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator) -> Any:
        now = scene.history.xy_m[:, -1]
        self.farthest_m = max(self.farthest_m, float(np.linalg.norm(now - now[scene.target], axis=-1).max()))
        return super().plan(road, scene, memory, rng)


def test_a_moved_vehicle_sees_farther_than_the_target(scene: SeedScene, road: RoadMap) -> None:
    planner, policy = Straight(), FarthestSeen()
    radii = {"control_radius_m": 30.0, "observe_radius_m": 30.0, "horizon_s": 5.0}
    record, _ = episode(scene, road, target=planner, background=policy, **radii).run()
    assert record.failure is None
    assert (record.controller == Controller.POLICY).any()
    assert 20.0 < planner.farthest_m <= 30.0
    assert policy.farthest_m > 40.0


def test_a_vehicle_that_is_about_to_arrive_is_left_to_sumo(
    scene: SeedScene, road: RoadMap, tmp_path: Path
) -> None:
    """SUMO's driver does not brake for vehicles beyond its goal. Once moved, such a vehicle could not stop any more."""
    with running(episode(scene, road, horizon_s=30.0, control_radius_m=200.0), tmp_path) as loop:
        world, vehicle = loop.world, loop.api.vehicle
        for steps in range(5, 301, 5):
            loop.run(steps)
            now = loop.scene_now()
            for k in np.flatnonzero(now.movable).tolist():
                row = world.row_of(now.history.ids[k])
                name = now.history.ids[k]
                left_m = loop.api.lane.getLength(vehicle.getLaneID(name)) - vehicle.getLanePosition(name)
                stops_m = world.speed_mps[row] ** 2 / 8.0
                if left_m < stops_m and not vehicle.getRoadID(name).startswith(":"):
                    vehicle.setRoute(name, [vehicle.getRoadID(name)])
                    later = loop.scene_now()
                    assert not later.movable[later.history.index[name]]
                    assert later.movable.sum() == now.movable.sum() - 1
                    return
    pytest.fail("nobody was about to leave an edge")


def test_the_same_episode_gives_the_same_record(scene: SeedScene, road: RoadMap) -> None:
    first, second = (
        episode(scene, road, target="lane_graph", background=StraightOn(), horizon_s=3.0).run()[0]
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.tracks.xy_m, second.tracks.xy_m)
    np.testing.assert_array_equal(first.controller, second.controller)


class Straight:
    """A planner that drives straight on, or does one thing that is not allowed."""

    def __init__(self, fault: str = "") -> None:
        self.fault, self.farthest_m = fault, 0.0

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> int:
        return 0

    def plan(self, road: RoadMap, scene: Scene, memory: int, rng: np.random.Generator) -> Any:
        assert scene.routes[scene.target]
        assert not any(route for k, route in enumerate(scene.routes) if k != scene.target)
        assert not scene.movable.any()
        now = scene.history.xy_m[:, -1]
        self.farthest_m = max(self.farthest_m, float(np.linalg.norm(now - now[scene.target], axis=-1).max()))
        if memory >= 2 and self.fault == "raises":
            raise RuntimeError("out of ideas")
        if memory >= 2 and self.fault == "nan":
            return Controls(np.full(10, np.nan), np.zeros(10), 0.1), memory + 1
        if memory >= 2 and self.fault == "jump":
            here = scene.history.xy_m[scene.target, -1]
            there = here + np.array([[100.0, 0.0], [100.0, 0.0]])
            return Trajectory(there, np.zeros(2), np.zeros(2), 0.5), memory + 1
        if memory >= 2 and self.fault == "nonsense":
            return "straight on", memory + 1
        return Controls(np.zeros(10), np.zeros(10), 0.1), memory + 1


@pytest.mark.parametrize(
    ("fault", "kind", "words"),
    [
        ("raises", "planner_error", "raised RuntimeError: out of ideas"),
        ("nan", "plan_refused", "not numbers"),
        ("jump", "plan_refused", "jump of 100"),
        ("nonsense", "plan_refused", "not a Trajectory or Controls"),
    ],
)
def test_a_faulty_planner_ends_the_episode_as_a_typed_failure(
    scene: SeedScene, road: RoadMap, fault: str, kind: str, words: str
) -> None:
    record, _ = episode(scene, road, target=Straight(fault), horizon_s=4.0).run()
    assert record.end == EndReason.FAILED
    assert record.failure is not None
    assert record.failure.kind == kind
    assert words in record.failure.message
    assert record.failure.time_s == pytest.approx(1.0)
    assert record.tracks.steps == 11


class Broken(StraightOn):
    """A policy that plans for the target, or plans a jump."""

    def __init__(self, fault: str) -> None:
        super().__init__()
        self.fault = fault

    def plan(self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator) -> Any:
        plan, _ = super().plan(road, scene, memory, rng)
        tracks = plan.tracks
        if self.fault == "jump":
            return JointPlan(replace(tracks, xy_m=tracks.xy_m + 200.0)), None
        if self.fault == "nan":
            return JointPlan(replace(tracks, yaw_rad=np.full_like(tracks.yaw_rad, np.nan))), None
        return JointPlan(replace(tracks, ids=(scene.target_id, *tracks.ids[1:]))), None


@pytest.mark.parametrize(
    ("fault", "words"),
    [("jump", "planned a jump"), ("nan", "not a number"), ("target", "planned for the target")],
)
def test_a_faulty_policy_is_refused_before_sumo_sees_it(
    scene: SeedScene, road: RoadMap, fault: str, words: str
) -> None:
    record, _ = episode(scene, road, background=Broken(fault), horizon_s=2.0).run()
    assert record.failure is not None
    assert record.failure.kind == "plan_refused"
    assert words in record.failure.message


class Exact(StraightOn):
    """A log of vehicles that stand, turned by *turn* and *away_m* from where they are, for the first second."""

    def __init__(self, turn: float, away_m: float) -> None:
        super().__init__(speed_mps=0.0, until_s=1.0)
        self.turn, self.away_m = turn, away_m

    def plan(self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator) -> Any:
        tracks = super().plan(road, scene, memory, rng)[0].tracks
        turn = self.turn if scene.time_s == 0.0 else 0.0  # it stays turned after that
        return JointPlan(
            replace(tracks, xy_m=tracks.xy_m + self.away_m, yaw_rad=tracks.yaw_rad + turn), exact=True
        ), None


def test_an_exact_plan_on_another_step_begins_where_its_vehicles_are(scene: SeedScene, road: RoadMap) -> None:
    """Without this, vehicles would be absent until the plan's first instant and be removed from the scene."""
    made = episode(scene, road, background=Exact(0.0, 0.0), horizon_s=1.0, step_s=0.05, control_radius_m=40.0)
    record, _ = made.run()
    moved = (record.controller == Controller.POLICY).any(axis=1)
    assert moved.any()
    assert record.tracks.valid[moved].all()


def test_what_is_between_two_instants_of_the_model_is_seen_of_signals(
    scene: SeedScene, road: RoadMap, tmp_path: Path
) -> None:
    with running(episode(scene, road, horizon_s=1.0), tmp_path) as loop:
        name = next(iter(loop.signals))
        before, lights = loop.signals[name], loop.api.trafficlight
        lights.setPhaseDuration(name, 0.25)
        loop.run(5)
        shown = [signals[name] for signals in loop.recorder.signals]
        assert lights.getRedYellowGreenState(name) != before
    assert shown == [before] * shown.count(before) + [shown[-1]] * (6 - shown.count(before))
    assert 1 <= shown.count(before) <= 4  # the next phase begins after 0.3 s, not with the next model step


def test_sumo_that_does_not_start_is_a_failure_of_its_episode(
    scene: SeedScene, road: RoadMap, tmp_path: Path
) -> None:
    record, _ = episode(replace(scene, net=tmp_path / "lost.net.xml"), road).run()
    assert record.end == EndReason.FAILED
    assert record.failure is not None
    assert record.failure.kind == "start_refused"
    assert "lost.net.xml" in record.failure.message
    assert record.tracks.steps == 1


def test_vehicles_that_sumo_gets_back_askew_are_counted(scene: SeedScene, road: RoadMap) -> None:
    near: dict[str, Any] = {"background": Exact(0.5 * np.pi, 0.0), "control_radius_m": 40.0}
    record, _ = episode(scene, road, horizon_s=7.0, **near).run()
    assert record.rough_handovers == 0  # they stand across their lanes, and may take 8 s to align
    record, _ = episode(scene, road, horizon_s=11.0, **near).run()
    moved = (record.controller == Controller.POLICY).any(axis=1)
    assert 1 <= record.rough_handovers <= moved.sum()
    assert record.skipped_agents == 0


def test_misaligned_standing_vehicles_start_and_align(scene: SeedScene, road: RoadMap) -> None:
    """They are turned by 23 degrees from their lanes."""
    record, _ = episode(scene, road, horizon_s=9.0, background=Exact(0.4, 0.0), control_radius_m=40.0).run()
    moved = (record.controller == Controller.POLICY).any(axis=1)
    back = (record.controller[moved] == Controller.SUMO).any(axis=1)
    assert back.sum() >= 1
    assert record.rough_handovers == 0


def test_agents_that_sumo_has_elsewhere_are_counted_and_left_alone(scene: SeedScene, road: RoadMap) -> None:
    near: dict[str, Any] = {"background": Exact(0.0, 60.0), "control_radius_m": 40.0}
    record, _ = episode(scene, road, horizon_s=0.5, **near).run()
    gap = np.linalg.norm(record.tracks.xy_m[:, 0] - record.tracks.xy_m[record.target, 0], axis=-1)
    assert record.skipped_agents == (gap <= 40.0).sum() - 1  # all but the target
    assert not (record.controller == Controller.POLICY).any()


def test_a_collision_ends_the_episode(scene: SeedScene, road: RoadMap) -> None:
    record, _ = episode(
        scene, road, target=Straight(), background=StraightOn(0.0), horizon_s=8.0, stop_at_collision=True
    ).run()
    assert record.end in {EndReason.COLLISION, EndReason.HORIZON}
    if record.end == EndReason.COLLISION:
        assert record.tracks.steps <= 81


def test_plans_and_the_natural_course_are_kept(scene: SeedScene, road: RoadMap) -> None:
    record, _ = episode(scene, road, "lane_graph", StraightOn(), horizon_s=3.0).run()
    assert [plans.made_s for plans in record.plans] == pytest.approx([0.5 * k for k in range(6)])
    assert all(plans.ids[0] == scene.target for plans in record.plans)
    assert max(len(plans.ids) for plans in record.plans) > 1
    for plans in record.plans:  # each begins where its vehicle is
        rows = [record.tracks.index[name] for name in plans.ids]
        now = record.tracks.xy_m[rows, round(plans.made_s / 0.1)]
        assert (np.linalg.norm(plans.xy_m[:, 0] - now, axis=-1) < 0.5 * 20.0).all()
    assert record.natural is not None
    start = record.natural.xy_m[record.natural.index[scene.target], 0]
    np.testing.assert_allclose(start, record.tracks.xy_m[record.target, 0], atol=1e-6)
    plain, _ = episode(scene, road, horizon_s=1.0, record_natural=False).run()
    assert (plain.plans, plain.natural) == ((), None)
