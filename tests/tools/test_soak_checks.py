"""The soak finds faults in states worked by hand; one place is run from end to end."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from tests.hang_guard import HANG_S
from tests.sim import nets

TOOLS = Path(__file__).parents[2] / "tools"
sys.path.insert(0, str(TOOLS))
from soak_src.checks import States, problems  # noqa: E402 - the tools are no package
from soak_src.lane_seams import carried_m  # noqa: E402
from soak_src.osm_maps import OSM_MAPS, write_osm_net  # noqa: E402

STEPS, STEP_S, SPEED_MPS = 11, 0.1, 10.0


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    return RoadMap.read(nets.street(tmp_path_factory.mktemp("street")))


def two_eastbound(gap_m: float) -> States:
    """Return two cars of 5 m × 1.8 m in the right eastbound lane (y = −4.8), *gap_m* apart, both at 10 m/s."""
    x = 100.0 + SPEED_MPS * STEP_S * np.arange(STEPS)
    xy = np.stack([np.stack((x + ahead, np.full(STEPS, -4.8)), -1) for ahead in (0.0, 5.0 + gap_m)])
    ones = np.ones((2, STEPS))
    return States(
        ("ego", "other"),
        0,
        np.full(2, 5.0),
        np.full(2, 1.8),
        xy,
        0.0 * ones,
        SPEED_MPS * ones,
        ones.astype(bool),
        ones.astype(bool),
        np.zeros((2, STEPS), dtype=bool),
        np.zeros(2, dtype=bool),
        STEP_S,
    )


def moved(states: States, dx: float, dy: float, since: int) -> States:
    """Return *states* with the other vehicle shifted from step *since* on."""
    xy = states.xy_m.copy()
    xy[1, since:] += (dx, dy)
    return replace(states, xy_m=xy)


def contact(time_s: float) -> dict[str, Any]:
    return {"time_s": time_s, "second": "other", "with_target": True, "initial": False}


def test_nothing_is_wrong_with_two_cars_in_a_row(road: RoadMap) -> None:
    assert list(problems(two_eastbound(10.0), road, [])) == []


def test_a_jump_in_position_speed_or_heading_is_named(road: RoadMap) -> None:
    states = two_eastbound(10.0)
    assert [*problems(moved(states, 2.0, 0.0, 4), road, [])] == [
        "jump in position of 'other' by 2.00 m after step 3"
    ]
    speed = states.speed_mps.copy()
    speed[1, 6:] = 14.0
    faster = replace(states, speed_mps=speed)
    assert "jump in speed of 'other' by 4.00 m/s after step 5" in [*problems(faster, road, [])]
    yaw = states.yaw_rad.copy()
    yaw[1, 6:] = 0.5
    turned = replace(states, yaw_rad=yaw, by_sumo=np.zeros((2, STEPS), dtype=bool))
    assert "jump in heading of 'other' by 0.50 rad after step 5" in [*problems(turned, road, [])]


def test_a_recorded_speed_may_jump_with_the_distance_travelled(road: RoadMap) -> None:
    """The speed jumps from 10 m/s to 14 m/s, and the positions agree, as with jitter of an annotation."""
    states = two_eastbound(10.0)
    xy, speed = states.xy_m.copy(), states.speed_mps.copy()
    speed[1, 6:] = 14.0
    xy[1, 6:, 0] += 0.2 + 0.4 * np.arange(STEPS - 6)
    faster = replace(states, xy_m=xy, speed_mps=speed)
    assert [*problems(faster, road, [])] == ["jump in speed of 'other' by 4.00 m/s after step 5"]
    recorded = replace(faster, recorded=np.ones((2, STEPS), dtype=bool))
    assert [*problems(recorded, road, [])] == []
    wrong = replace(recorded, xy_m=states.xy_m)  # moves at 10 m/s, but the recorded speed is 14 m/s
    assert [*problems(wrong, road, [])] == ["jump in speed of 'other' by 4.00 m/s after step 6"]


def test_nan_and_a_sumo_vehicle_beside_all_lanes_are_named(road: RoadMap) -> None:
    states = two_eastbound(10.0)
    speed = states.speed_mps.copy()
    speed[1, 3] = np.nan
    assert "NaN in a state of 'other'" in [*problems(replace(states, speed_mps=speed), road, [])]
    beside = moved(states, 0.0, -4.0, 0)  # 8.8 m south; the lane ends at 6.4 m
    assert [*problems(beside, road, [])] == ["'other' is driven by SUMO 2.40 m beside all lanes at step 0"]


def test_a_lane_may_be_wide(tmp_path: Path) -> None:
    """The lane extends from y = 0 to −16 m, so that 7.5 m beside its centre line is on the lane, and 8.5 m is not."""
    edges = nets.STREET[1].replace('numLanes="2"', 'numLanes="1" width="16"')
    wide = RoadMap.read(nets.build(tmp_path, nets.STREET[0], edges, name="wide"))
    states = two_eastbound(10.0)
    assert [*problems(moved(states, 0.0, 4.8 - 15.5, 0), wide, [])] == []
    assert [*problems(moved(states, 0.0, 4.8 - 16.5, 0), wide, [])] == [
        "'other' is driven by SUMO 0.50 m beside all lanes at step 0"
    ]


SLANTED = """<edges>
<edge id="slanted" from="W" to="M" numLanes="2" speed="14" length="195">
<lane index="0" shape="0,-4.8 200,-4.8"/><lane index="1" shape="0,-1.6 180,-1.6"/>
</edge>
<edge id="on" from="M" to="E" numLanes="2" speed="14"/>
</edges>"""


def test_a_lane_change_between_lanes_of_unequal_length_is_sumos_own_jump(tmp_path: Path) -> None:
    """The shapes of the lanes are 190 m and 180 m long, but SUMO's length is 195 m; 130 m is at x = 127 and x = 120."""
    net = nets.build(tmp_path, nets.STREET[0], SLANTED, name="slanted")
    lengths = RoadMap.read(net)
    places, lanes = [], []
    with nets.stage(net) as s:
        s.add("other", ("slanted", "on"), at=120.0, speed=10.0)
        s.free("other")
        s.api.vehicle.setSpeed("other", 10.0)
        s.api.vehicle.changeSublane("other", 3.2)
        while len(places) < 40:
            places.append(s.pose("other")[0])
            lanes.append(s.api.vehicle.getLaneIndex("other"))
            s.step()
    change = lanes.index(1)
    states = two_eastbound(10.0)
    xy = states.xy_m.copy()
    xy[1] = places[change - 5 : change + 6]
    xy[0, :, 0] -= 80.0
    jumped = replace(states, xy_m=xy)
    excess = float(np.hypot(*(xy[1, 5] - xy[1, 4]))) - 1.0
    assert excess > 5.0
    most = carried_m(lengths, xy[1, 4] + (2.5, 0.0), 1.0)[1]
    # the same lane change in the opposite direction moves the vehicle by +1 m instead of −1 m
    assert most == pytest.approx(excess + 2.0, abs=0.5)
    assert [*problems(jumped, lengths, [])] == []
    moved_by_us = replace(jumped, sumo_course=np.zeros((2, STEPS), dtype=bool))
    assert any("jump in position of 'other'" in sentence for sentence in problems(moved_by_us, lengths, []))
    beyond = moved(jumped, -5.0, 0.0, 5)
    assert any("jump in position of 'other'" in sentence for sentence in problems(beyond, lengths, []))


def test_contacts_must_be_those_of_the_boxes(road: RoadMap) -> None:
    overlapping = two_eastbound(-0.5)
    assert [*problems(overlapping, road, [])] == [
        "the boxes of target and 'other' overlap at step 0, which is not recorded"
    ]
    assert [*problems(overlapping, road, [contact(0.0)])] == []
    assert [*problems(overlapping, road, [contact(0.5)])] == [
        "contact of target and 'other' is recorded at step 5, the boxes overlap at 0"
    ]
    assert [*problems(two_eastbound(3.0), road, [contact(0.5)])] == [
        "contact of target and 'other' is recorded at step 5, where the boxes are apart"
    ]


@pytest.mark.parametrize("name", OSM_MAPS)
def test_an_openstreetmap_file_is_converted_to_a_net(tmp_path: Path, name: str) -> None:
    write_osm_net(name, tmp_path / f"{name}.net.xml")
    road = RoadMap.read(tmp_path / f"{name}.net.xml")
    assert road.edge_graph().strongly_connected()
    west, south, east, north = road.bounds
    assert 250.0 < max(east - west, north - south) < 1100.0
    lights = any(junction.type == "traffic_light" for junction in road.junctions.values())
    assert lights == (name == "osm-signals")
    closed = {lane.allows for lane in road.lanes.values() if not lane.permits("passenger")}
    assert any("bicycle" in allows for allows in closed) == (name == "osm-cycleways")
    assert any("rail" in allows for allows in closed) == (name == "osm-rail")


@pytest.mark.slow
def test_an_interrupted_soak_can_be_continued(tmp_path: Path) -> None:
    """Ctrl-C interrupts the first place; the second call runs the remaining episodes.

    There are enough episodes that some remain even if it takes long to notice the first one.
    """
    words = [sys.executable, str(TOOLS / "soak.py"), str(tmp_path), "--episodes", "4", "--horizon", "1"]
    words += ["--seeds", "0", "--workers", "1", "--places", "osm-roundabout", "osm-signals"]
    words += ["--backgrounds", "sumo"]
    heard = signal.signal(signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    signal.signal(signal.SIGINT, heard)
    finished = "osm-*/episodes/??/" + 24 * "[0-9a-f]"
    while not list(tmp_path.glob(finished)) and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=HANG_S)
    assert (process.returncode, "the same command goes on" in said) == (130, True), said
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob(finished)}
    assert before
    again = subprocess.run(words, capture_output=True, text=True, timeout=HANG_S, check=False)
    assert again.returncode == 0, again.stdout + again.stderr
    assert "total: 2 places, 24 sound" in again.stdout
    assert before == {path: path.stat().st_mtime_ns for path in before}


@pytest.mark.slow
def test_a_second_call_does_not_repeat_finished_episodes(tmp_path: Path) -> None:
    words = [sys.executable, str(TOOLS / "soak.py"), str(tmp_path), "--episodes", "1", "--horizon", "1"]
    words += ["--seeds", "0", "--workers", "1", "--places", "downtown", "--backgrounds", "sumo", "replay"]
    first = subprocess.run(words, capture_output=True, text=True, timeout=HANG_S, check=False)
    assert first.returncode == 0, first.stdout + first.stderr
    assert "total: 1 places, 6 sound" in first.stdout
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "downtown/episodes").glob("*/*")}
    assert len(before) == 6
    again = subprocess.run(words, capture_output=True, text=True, timeout=HANG_S, check=False)
    assert again.stdout == first.stdout
    assert before == {path: path.stat().st_mtime_ns for path in before}
