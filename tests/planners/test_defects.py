"""Planted defects: how they are written, and what each does to a scene or a plan, computed by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError, UnknownNameError
from advdiff_sumo.core.plan import Trajectory
from advdiff_sumo.core.scene import AgentClass, Scene, Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.defects import DEFECTS, SEVERITIES, parse_defect, parse_defects, plant
from advdiff_sumo.planners.defects.defective_planner import DefectivePlanner
from advdiff_sumo.planners.defects.planted_defect import PlantedDefect
from advdiff_sumo.planners.planner_check import check_planner, same_plan
from advdiff_sumo.planners.planner_protocol import Served, SumoDriver
from advdiff_sumo.planners.planner_registry import make_target

from .scenes import Car, make_scene
from .test_lane_graph import ACROSS, Maker

SEED = SeedTree(1)
PAST_S = 0.5 * np.arange(-4, 1)


def agents(*rows: tuple[float, float, float, float], classes: tuple[int, ...] = ()) -> Scene:
    """Return a scene of agents (x, y, yaw in degrees, speed) at constant velocity; the first is the target."""
    x, y, yaw, speed = (np.array(values, dtype=np.float64) for values in zip(*rows, strict=True))
    yaw = np.deg2rad(yaw)
    way = np.stack((np.cos(yaw), np.sin(yaw)), -1)
    xy = np.stack((x, y), -1)[:, None] + (speed[:, None] * PAST_S)[..., None] * way[:, None]
    shape = (len(rows), len(PAST_S))
    tracks = Tracks(
        ids=tuple("tabcdef"[: len(rows)]),
        classes=np.array(classes or (0,) * len(rows)),
        size_m=np.tile((4.6, 1.8), (len(rows), 1)),
        xy_m=xy,
        yaw_rad=np.broadcast_to(yaw[:, None], shape).copy(),
        speed_mps=np.broadcast_to(speed[:, None], shape).copy(),
        valid=np.ones(shape, dtype=np.bool_),
        t0_s=-2.0,
        dt_s=0.5,
    )
    return Scene(tracks, 0, np.zeros(len(rows), np.bool_), ((),) * len(rows), {})


def later(scene: Scene, seconds: float, **states: Any) -> Scene:
    return replace(scene, history=replace(scene.history.shifted(seconds), **states))


def perceived(defect: str, scene: Scene, road: Any = None, memory: Any = None) -> tuple[Scene, Any]:
    planted = parse_defect(defect)
    return planted.kind.fault(planted.value).perceive(road, scene, memory, SEED)


def shown(defect: str, scene: Scene) -> str:
    return "".join(perceived(defect, scene)[0].history.ids)


def stop(brake_mps2: float, speed_mps: float = 10.0) -> Trajectory:
    """Return 2 s of even braking east from the origin."""
    t = 0.1 * np.arange(1, 21)
    speed = np.maximum(speed_mps - brake_mps2 * t, 0.0)
    s = np.cumsum(0.5 * (speed + np.append(speed_mps, speed[:-1]))) * 0.1
    return Trajectory(np.column_stack((s, np.zeros(20))), np.zeros(20), speed, 0.1)


class Counting:
    """Plans a stop, and counts its plans in its memory."""

    def start(self, road: Any, scene: Scene, rng: np.random.Generator) -> int:
        return 0

    def plan(self, road: Any, scene: Scene, memory: int, rng: np.random.Generator) -> tuple[Trajectory, int]:
        return replace(stop(2.0), speed_mps=stop(2.0).speed_mps + 1e-3 * rng.random()), memory + 1


# --- notation ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("late:1.0", "late:middle", 1.0),
        ("LATE:0.7s", "late:0.7", 0.7),
        ("range:strong", "range:strong", 12.0),
        ("blind_crossing:30 deg", "blind-crossing:30", 30.0),
        ("weak-brakes:2.5m/s2", "weak-brakes:middle", 2.5),
        ("position-bias:-1.5", "position-bias:-1.5", -1.5),
    ],
)
def test_a_name_and_a_severity(text: str, name: str, value: float) -> None:
    defect = parse_defect(text)
    assert (defect.name, defect.value) == (name, value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("rnage:3", "unknown defect 'rnage'; did you mean 'range'?"),
        (
            "late",
            "defect 'late' lacks its severity; give weak (0.5 s), middle (1 s), strong (2 s), or a number",
        ),
        ("late:stong", "defect 'late' has no severity 'stong'; did you mean 'strong'?"),
        ("late:2km", "defect 'late': its unit is 's', not 'km'"),
        ("late:99", "defect 'late': 99 s is not within 0 to 5 s"),
        ("late:nan", "defect 'late' has no severity 'nan'"),
    ],
)
def test_an_invalid_defect_is_one_sentence(text: str, said: str) -> None:
    with pytest.raises((ConfigError, UnknownNameError)) as raised:
        parse_defect(text)
    assert said in str(raised.value)


def test_the_option_takes_one_or_several_defects_but_none_twice() -> None:
    assert [d.name for d in parse_defects("late:weak")] == ["late:weak"]
    assert [d.name for d in parse_defects(["late:weak", "range:9"])] == ["late:weak", "range:9"]
    with pytest.raises(ConfigError, match="defect 'late' is given twice"):
        parse_defects(["late:weak", "late:2"])
    with pytest.raises(ConfigError, match="expected a list of texts"):
        parse_defects([1.0])
    with pytest.raises(ConfigError, match="expected a list of texts"):
        parse_defects({"late": 1.0})


def test_the_catalogue_is_consistent() -> None:
    assert len(DEFECTS) >= 12
    for kind in DEFECTS.values():
        low, high = kind.bounds
        assert all(low <= value <= high for value in kind.values), kind.name
        assert list(kind.values) in (sorted(kind.values), sorted(kind.values, reverse=True)), kind.name
        assert (kind.sumo is None) == kind.sumo_note.startswith("none: "), kind.name
        for severity in SEVERITIES:
            assert isinstance(kind.fault(parse_defect(f"{kind.name}:{severity}").value), PlantedDefect)


# --- hidden road users -------------------------------------------------------------------------------------


def test_hidden_road_users() -> None:
    ahead, beside, crossing, oncoming = (
        (20.0, 0.0, 0.0, 9.0),
        (0.0, 3.0, 0.0, 9.0),
        (30.0, -20.0, 90.0, 9.0),
        (40.0, 3.0, 180.0, 1.0),
    )
    scene = agents((0.0, 0.0, 0.0, 10.0), ahead, beside, crossing, oncoming, classes=(0, 1, 0, 4, 2))
    assert shown("range:25", scene) == "tab"  # the crossing one is 36 m away
    assert shown("tunnel:20", scene) == "tad"  # 33.7° to the right; 4.3° to the left
    assert shown("blind-crossing:10", scene) == "tabd"
    assert shown("blind-oncoming:10", scene) == "tabc"
    assert shown("blind-standing:2", scene) == "tabc"
    assert shown("blind-heavy:0", scene) == "tbc"
    assert shown("blind-heavy:20", scene) == "tabc"
    assert shown("blind-unprotected:0", scene) == "tabd"
    assert scene.history.ids == ("t", "a", "b", "c", "d")


def test_the_target_is_never_hidden_whatever_its_row() -> None:
    scene = agents((90.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 10.0), (8.0, 0.0, 0.0, 10.0))
    given, _ = perceived("range:20", replace(scene, target=1, routes=((), ("e",), ())))
    assert (given.history.ids, given.target_id, given.routes) == (("a", "b"), "a", (("e",), ()))


def test_flicker_and_dropout_miss_the_given_share() -> None:
    scene = agents((0.0, 0.0, 0.0, 10.0), (20.0, 0.0, 0.0, 9.0))
    times = 0.5 * np.arange(2000)
    for defect, share in (("flicker:0.3", 0.3), ("dropout:2", 1 / 3)):
        seen = [len(shown(defect, later(scene, t))) == 2 for t in times]
        assert 1.0 - np.mean(seen) == pytest.approx(
            share, abs=0.04
        )  # 4 standard deviations of a share among 2000
        more = "flicker:0.9" if defect.startswith("flicker") else "dropout:4"
        assert all(
            x or len(shown(more, later(scene, t))) == 1 for x, t in zip(seen[:200], times, strict=False)
        )
    gone = [len(shown("dropout:2", later(scene, t))) == 1 for t in times[:24]]
    assert sum(a != b for a, b in pairwise(gone)) in (
        3,
        4,
    )  # one interval in every 6 s, during 12 s


# --- wrong states -----------------------------------------------------------------------------------------


def test_late_shows_the_others_and_signals_of_a_second_ago() -> None:
    scene = replace(agents((0.0, 0.0, 0.0, 10.0), (30.0, 0.0, 0.0, 8.0)), signals={"J": "r"})
    given, memory = perceived("late:1", scene)
    assert given.history.xy_m[1, -1].tolist() == [22.0, 0.0]
    assert given.history.xy_m[1, -3].tolist() == [14.0, 0.0]  # a second before that: 2 s ago
    assert given.history.valid[1].tolist() == [False, False, True, True, True]
    assert np.isnan(given.history.xy_m[1, 0]).all()
    assert (given.history.xy_m[0] == scene.history.xy_m[0]).all()
    for seconds, letter in ((0.5, "r"), (1.0, "r"), (1.5, "g")):
        now = replace(later(scene, seconds), signals={"J": "g"})
        given, memory = perceived("late:1", now, memory=memory)
        assert given.signals == {"J": letter}, seconds


def test_late_interpolates_and_hides_new_arrivals() -> None:
    scene = agents((0.0, 0.0, 0.0, 10.0), (30.0, 0.0, 0.0, 8.0))
    given, _ = perceived("late:0.25", scene)
    assert given.history.xy_m[1, -1] == pytest.approx([28.0, 0.0])
    history = scene.history
    fresh = np.array([[True] * 5, [False] * 4 + [True]])
    blank = np.where(fresh, 0.0, np.nan)
    just_come = later(
        scene, 0.0, valid=fresh, xy_m=history.xy_m + blank[..., None], speed_mps=history.speed_mps + blank
    )
    assert perceived("late:0.5", just_come)[0].history.ids == ("t",)


def test_constant_velocity_overlooks_the_braking_of_the_last_second() -> None:
    """10 m/s until a second ago, then braking at 4 m/s²: it drove 8 m instead of 10, and has 6 m/s instead of 10."""
    scene = agents((0.0, 0.0, 0.0, 10.0), (30.0, 0.0, 0.0, 10.0))
    xy, speed = scene.history.xy_m.copy(), scene.history.speed_mps.copy()
    xy[1, 3:, 0], speed[1, 3:] = (20.0 + 4.5, 20.0 + 8.0), (8.0, 6.0)
    given, _ = perceived("constant-velocity:1", later(scene, 0.0, xy_m=xy, speed_mps=speed))
    assert given.history.xy_m[1, -1] == pytest.approx([30.0, 0.0])
    assert given.history.speed_mps[1, -1] == 10.0
    assert given.history.valid.all()


def test_wrong_states() -> None:
    scene = agents((0.0, 0.0, 90.0, 10.0), (0.0, 30.0, 90.0, 8.0), (-3.0, 10.0, 90.0, 8.0))
    frozen, _ = perceived("frozen:0.75", scene)
    assert frozen.history.speed_mps[1, -1] == 2.0
    assert frozen.history.xy_m[1, :, 1] == pytest.approx([26.0, 27.0, 28.0, 29.0, 30.0])
    fast, _ = perceived("speed-bias:2", scene)
    assert fast.history.speed_mps[1, -1] == 10.0
    assert fast.history.xy_m[1, :, 1] == pytest.approx([10.0, 15.0, 20.0, 25.0, 30.0])
    aside, _ = perceived("position-bias:1.5", scene)  # its left is west
    assert aside.history.xy_m[1, -1] == pytest.approx([-1.5, 30.0])
    close, _ = perceived("headway:1.2", scene)
    assert close.history.xy_m[1, -1] == pytest.approx([0.0, 42.0])
    assert close.history.xy_m[2, -1] == pytest.approx([-3.0, 10.0])  # in the next lane
    for wrong in (frozen, fast, aside, close):
        assert (wrong.history.xy_m[0] == scene.history.xy_m[0]).all()


def test_localisation_displaces_the_scene_and_the_plan_back() -> None:
    scene = agents((0.0, 0.0, 0.0, 10.0), (20.0, 0.0, 0.0, 10.0))
    planted = parse_defect("localisation:2")
    fault = planted.kind.fault(planted.value)
    given, _ = fault.perceive(None, scene, None, SEED)  # type: ignore[arg-type] # it looks at no map
    assert given.history.xy_m[:, -1] == pytest.approx(np.array([[0.0, 2.0], [20.0, 2.0]]))
    plan = Trajectory(np.array([[5.0, 2.0], [10.0, 1.0]]), np.zeros(2), np.full(2, 10.0), 0.5)
    driven, _ = fault.act(plan, scene, None)
    assert isinstance(driven, Trajectory)
    assert driven.xy_m == pytest.approx(np.array([[5.0, 0.0], [10.0, -1.0]]))


# --- rules ------------------------------------------------------------------------------------------------


def test_signals_turns_only_the_targets_own_light_green_for_a_time(crossing: Maker) -> None:
    road: RoadMap = crossing("traffic_light")
    own = [x for x in road.lanes["south_in_0"].successors if road.lanes[x.to_lane].edge_id == "north_out"]
    assert own[0].tls_index is not None
    size = 1 + max(link.tls_index or 0 for link in road.links.values())
    scene = make_scene(road, [Car("south_in_0", 150.0, 10.0)], ACROSS, {own[0].tls_id or "": "r" * size})
    given, memory = perceived("signals:4", scene, road)
    state = given.signals[own[0].tls_id or ""]
    assert {k for k, letter in enumerate(state) if letter == "G"} == {x.tls_index for x in own}
    still, memory = perceived("signals:4", later(scene, 3.5), road, memory)
    assert still.signals == given.signals
    over, _ = perceived("signals:4", later(scene, 4.0), road, memory)
    assert over.signals == scene.signals


def test_vehicles_with_the_right_of_way_are_hidden_until_they_have_left(crossing: Maker) -> None:
    road: RoadMap = crossing("priority")
    cars = [
        Car("south_in_0", 150.0, 10.0),
        Car("west_in_0", 150.0, 10.0),
        Car("west_out_0", 20.0, 10.0),
        Car("north_in_0", 150.0, 0.0),
    ]
    scene = make_scene(road, cars, ACROSS)
    assert perceived("priority:1", scene, road)[0].history.ids == ("car0", "car2", "car3")
    assert perceived("priority:0", scene, road)[0].history.ids == scene.history.ids
    major = make_scene(
        road, [Car("west_in_0", 150.0, 10.0), Car("south_in_0", 150.0, 10.0)], ("west_in", "east_out")
    )
    assert perceived("priority:1", major, road)[0].history.ids == ("car0", "car1")


def test_a_cut_in_is_noticed_late(crossing: Maker) -> None:
    """A car changes from the left lane (1) to the right one (0), and is in it for 1.5 s."""
    road: RoadMap = crossing()
    lanes = [
        ("west_in_1", -1.0),
        ("west_in_0", 1.2),
        ("west_in_0", 0.0),
        ("west_in_0", 0.0),
        ("west_in_0", 0.0),
    ]
    memory, offsets = None, []
    for k, (lane, aside) in enumerate(lanes):
        scene = later(
            make_scene(
                road, [Car("west_in_0", 50.0, 10.0), Car(lane, 80.0, 10.0, aside)], ("west_in", "east_out")
            ),
            0.5 * k,
        )
        given, memory = perceived("cut-in:1.5", scene, road, memory)
        offsets.append(float(road.lanes["west_in_0"].line.project(given.history.xy_m[1, -1])[1]))
    assert offsets == pytest.approx([3.2, 3.2, 3.2, 3.2, 0.0], abs=1e-6)


def test_a_cut_in_before_a_junction_is_noticed_late_beyond_it(
    crossing: Maker,
) -> None:
    road: RoadMap = crossing()
    way = road.links["west_in_0", "east_out_0"].via[0]
    length_m = road.lanes[way].length_m
    memory, offsets = None, []
    places = [
        ("west_in_1", 180.0),
        ("west_in_0", 185.0),
        (way, 2.0),
        (way, 0.5 * length_m),
        ("east_out_0", 5.0),
    ]
    for k, (lane, s) in enumerate([*places, ("east_out_0", 20.0)]):
        cars = [Car("west_in_0", 50.0, 10.0), Car(lane, s, 10.0)]
        scene = later(make_scene(road, cars, ("west_in", "east_out")), 0.5 * k)
        given, memory = perceived("cut-in:2", scene, road, memory)
        if lane == way:
            assert (given.history.xy_m == scene.history.xy_m).all()
        offsets.append(float(given.history.xy_m[1, -1, 1] - road.to_world(lane, s)[0][1]))
    assert offsets == pytest.approx([0.0, 3.2, 0.0, 0.0, 3.2, 0.0], abs=1e-6)  # noticed at 0.5 + 2 s


def test_pedestrians_are_not_moved_to_lanes(crossing: Maker) -> None:
    road: RoadMap = crossing()
    cars = [Car("west_in_0", 50.0, 10.0), Car("west_in_0", 80.0, 1.0, 1.2)]
    scene = make_scene(road, cars, ("west_in", "east_out"))
    people = np.array([AgentClass.CAR, AgentClass.PEDESTRIAN])
    scene = later(scene, 0.0, classes=people)
    assert (perceived("cut-in:1.5", scene, road)[0].history.xy_m == scene.history.xy_m).all()


# --- together, and in SUMO's drivers ----------------------------------------------------------------------


def test_planners_with_defects_keep_the_contract_and_draw_the_same_numbers(crossing: Maker) -> None:
    road: RoadMap = crossing("traffic_light")
    cars = [Car("south_in_0", 120.0, 10.0), Car("south_in_0", 150.0, 6.0), Car("west_in_0", 160.0, 10.0)]
    scene = make_scene(road, cars, ACROSS, {"c": "r" * 20})
    for name in DEFECTS:
        target = make_target("lane_graph", {"defects": [f"{name}:strong"]})
        assert not isinstance(target, SumoDriver)
        assert check_planner(target, road, scene) == [], name
    sound, planted = Counting(), DefectivePlanner(Counting(), ())  # type: ignore[arg-type] # no map is needed
    plans = []
    for planner in (sound, planted):
        rng: np.random.Generator = np.random.default_rng(7)
        memory: Any = planner.start(road, scene, rng)
        plans.append(planner.plan(road, scene, memory, rng)[0])
    assert same_plan(*plans)


def test_several_defects_act_in_their_order() -> None:
    scene = agents((0.0, 0.0, 0.0, 10.0), (20.0, 0.0, 0.0, 10.0))
    for order, is_seen in (("late:1", True), ("range:12", False)):
        first = [order, "range:12" if order == "late:1" else "late:1"]
        faults = [d.kind.fault(d.value) for d in parse_defects(first)]
        given = scene
        for fault in faults:
            given, _ = fault.perceive(None, given, None, SEED)  # type: ignore[arg-type] # no map is looked at
        assert (given.history.agents == 2) is is_seen  # late shows it at 10 m, which is within the range


def test_sumos_models_get_sumos_own_parameters() -> None:
    planted = make_target(
        "IDM", {"tau": 1.5, "defects": ["late:1.0", "weak-brakes:2", "stuck:4", "priority:0.5"]}
    )
    assert isinstance(planted, SumoDriver)
    assert planted.params == {
        "tau": 1.5,
        "actionStepLength": 4.0,
        "decel": 2.0,
        "emergencyDecel": 2.0,
        "jmIgnoreFoeProb": 0.5,
        "jmIgnoreFoeSpeed": 1000.0,
        "jmIgnoreJunctionFoeProb": 0.5,
    }
    headway = make_target("Krauss", {"tau": 1.5, "defects": "headway:0.8"})
    assert isinstance(headway, SumoDriver)
    assert headway.params["tau"] == pytest.approx(0.7)
    with pytest.raises(ConfigError, match="defect 'tunnel' has no form for target 'IDM', which SUMO drives"):
        make_target("IDM", {"defects": ["tunnel:strong"]})


def test_weak_brakes_are_never_stronger_than_the_targets_own() -> None:
    for options, decel, emergency in (({}, 4.5, 6.0), ({"decel": 2.0}, 2.0, 6.0)):
        planted = make_target("IDM", {**options, "defects": "weak-brakes:6"})
        assert isinstance(planted, SumoDriver)
        assert (planted.params["decel"], planted.params["emergencyDecel"]) == (decel, emergency)


@pytest.mark.parametrize(
    ("own", "driven"),
    [
        ({"actionStepLength": 2.0, "jmDriveAfterRedTime": 10.0}, (2.0, 10.0)),
        ({"actionStepLength": "2.0", "jmDriveAfterRedTime": -1}, (2.0, 1.0)),  # -1: never
        ({"actionStepLength": 0.1, "jmDriveAfterRedTime": "nan"}, (0.5, 1.0)),
        ({"actionStepLength": "soon"}, (0.5, 1.0)),
    ],
)
def test_a_defect_never_improves_the_targets_own_values(
    own: dict[str, float | str], driven: tuple[float, float]
) -> None:
    planted = make_target("IDM", {"params": own, "defects": ["late:weak", "signals:weak"]})
    assert isinstance(planted, SumoDriver)
    assert tuple(planted.params[key] for key in ("actionStepLength", "jmDriveAfterRedTime")) == driven


def test_priority_never_ignores_fewer_than_the_target_itself() -> None:
    own = {"jmIgnoreFoeProb": 0.9, "jmIgnoreJunctionFoeProb": 0.1, "jmIgnoreFoeSpeed": 5.0}
    planted = make_target("IDM", {"params": own, "defects": "priority:weak"})
    assert isinstance(planted, SumoDriver)
    assert planted.params == {
        "jmIgnoreFoeProb": 0.9,
        "jmIgnoreJunctionFoeProb": 0.25,
        "jmIgnoreFoeSpeed": 1000.0,
    }


@pytest.mark.parametrize("name", ["W99", "Wiedemann", "CACC"])
def test_a_headway_that_a_model_does_not_read_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name} follows no closer for a shorter tau"):
        make_target(name, {"defects": "headway:strong"})


class Distant(Counting):
    """A planner with a resource outside this process; it records its calls."""

    def __init__(self) -> None:
        self.heard: list[object] = []

    def check(self) -> None:
        self.heard.append("check")

    def end(self, memory: Any, end: str, time_s: float, failure: str) -> None:
        self.heard.append((memory, end, time_s, failure))

    def close(self) -> None:
        self.heard.append("close")


def test_a_remote_planner_with_a_defect_is_checked_ended_and_closed() -> None:
    scene, distant = agents((0.0, 0.0, 0.0, 10.0)), Distant()
    planner = plant(distant, parse_defects("late:1"), "distant")  # type: ignore[arg-type] # no map is needed
    assert isinstance(planner, Served)
    planner.check()
    rng = np.random.default_rng(0)
    _, memory = planner.plan(None, scene, planner.start(None, scene, rng), rng)  # type: ignore[attr-defined] # the same
    planner.end(memory, "horizon", 4.0, "")
    planner.close()
    assert distant.heard == ["check", (1, "horizon", 4.0, ""), "close"]
    assert not isinstance(plant(Counting(), parse_defects("late:1"), "near"), Served)  # type: ignore[arg-type] # the same


def test_classes_are_the_packages_own() -> None:
    assert [AgentClass.TRUCK, AgentClass.BUS] == [1, 2]
