"""SUMO's own programs read what the converter writes."""

from __future__ import annotations

import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import sumolib
from defusedxml import ElementTree
from small_maps import crossroads, two_lane_road

from advdiff_sumo.maps.convert import ConversionResult, convert_map, polyline
from advdiff_sumo.maps.convert.written_net import WrittenNet, read_net
from tests.hang_guard import HANG_S

ROUND_TRIP_M = 0.02
MAPS = {"two lanes": two_lane_road, "crossing": crossroads}
SUMO_HOME = Path(sumolib.checkBinary("netconvert")).resolve().parents[1]
REAL = pytest.param("singapore-onenorth", marks=pytest.mark.data)


@pytest.fixture(scope="module", params=[*MAPS, REAL])
def result(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> ConversionResult:
    """A converted map: two made by hand and a real one."""
    folder = tmp_path_factory.mktemp("net")
    if request.param in MAPS:
        path = MAPS[request.param]().write(folder / "m.json")
    else:
        data: Path = request.getfixturevalue("adv_data")
        path = data / "nuscenes-mini" / "maps" / "expansion" / f"{request.param}.json"
    return convert_map(path, folder / "m.net.xml")


def run(command: Sequence[str | Path], **environment: str) -> str:
    """Run a program of SUMO, which must succeed, and return its output."""
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        check=False,
        timeout=HANG_S,
        env={**os.environ, "SUMO_HOME": str(SUMO_HOME), **environment},
    )
    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr
    return done.stdout + done.stderr


def off(before: WrittenNet, after: WrittenNet) -> float:
    """Return the largest distance between lanes and connections before and after, in both directions."""
    pairs = [(line, after.lanes[key][0]) for key, (line, _) in before.lanes.items()]
    pairs += [(line, after.connections[key][0]) for key, (line, _) in before.connections.items()]
    away = [np.abs(polyline.project(a, polyline.resample(b, 0.5)[0])[1]).max() for a, b in pairs]
    away += [np.abs(polyline.project(b, polyline.resample(a, 0.5)[0])[1]).max() for a, b in pairs]
    return float(max(away))


def test_sumolib(result: ConversionResult) -> None:
    net = sumolib.net.readNet(str(result.net), withInternal=True, withPrograms=True)
    assert len(net.getEdges(withInternal=False)) == len(result.plan.edges)
    assert sum(len(node.getConnections()) > 0 for node in net.getNodes()) > 0
    for edge in result.plan.edges:
        assert net.getEdge(edge.id).getLaneNumber() == len(edge.lanes)


def test_netconvert_round_trip_keeps_everything(result: ConversionResult, tmp_path: Path) -> None:
    again = tmp_path / "again.net.xml"
    command = [sumolib.checkBinary("netconvert"), "--sumo-net-file", result.net, "-o", again]
    run([*command, "--precision", "4", "--offset.disable-normalization", "true", "--no-turnarounds", "true"])
    before, after = read_net(result.net), read_net(again)
    assert after.lanes.keys() == before.lanes.keys()
    assert after.connections.keys() == before.connections.keys()
    assert off(before, after) <= ROUND_TRIP_M


def test_random_trips_and_duarouter(result: ConversionResult, tmp_path: Path) -> None:
    trips, routes = tmp_path / "t.trips.xml", tmp_path / "t.rou.xml"
    tool = SUMO_HOME / "tools" / "randomTrips.py"
    unused = tmp_path / "unused.rou.xml"  # else it is written where the tests are run
    run([sys.executable, tool, "-n", result.net, "-o", trips, "-r", unused, "-e", "100", "--seed", "3"])
    asked = len(list(sumolib.xml.parse(str(trips), "trip")))
    assert asked == 100
    run([sumolib.checkBinary("duarouter"), "-n", result.net, "-r", trips, "-o", routes, "--ignore-errors"])
    routed = list(sumolib.xml.parse(str(routes), "vehicle"))
    assert routed
    known = read_net(result.net).next_edges
    for vehicle in routed:
        edges = vehicle.route[0].edges.split()
        assert all(b in known[a] for a, b in itertools.pairwise(edges))


def test_duarouter_finds_the_one_way_through(tmp_path: Path) -> None:
    result = convert_map(two_lane_road().write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    first, last = (edge.id for edge in sorted(result.plan.edges, key=lambda e: e.lanes[0].shape_m[0, 0]))
    trips, routes = tmp_path / "t.trips.xml", tmp_path / "t.rou.xml"
    trips.write_text(f'<routes><trip id="0" depart="0" from="{first}" to="{last}"/></routes>', "utf-8")
    run([sumolib.checkBinary("duarouter"), "-n", result.net, "-r", trips, "-o", routes])
    (vehicle,) = sumolib.xml.parse(str(routes), "vehicle")
    assert vehicle.route[0].edges.split() == [first, last]


def test_net_and_side_car_load_in_the_simulation(result: ConversionResult, tmp_path: Path) -> None:
    command = [sumolib.checkBinary("sumo"), "-n", result.net, "-a", result.sidecar, "-e", "5"]
    said = run([*command, "--no-step-log", "true"])
    assert "Warning" not in "".join(line for line in said.splitlines() if "proj" not in line)
    areas = ElementTree.fromstring(result.sidecar.read_bytes()).findall("poly")
    assert areas
    assert {area.get("type") for area in areas} >= {"drivable_area"}


def test_sumo_gui_shows_net_and_side_car(tmp_path: Path) -> None:
    gui = Path(sumolib.checkBinary("sumo-gui"))
    screen = shutil.which("xvfb-run")
    if screen is None or not gui.exists():
        pytest.skip("xvfb-run or sumo-gui is not installed: a window cannot be opened here")
    road = crossroads()
    road.area("ped_crossing", [(108.0, 95.0), (110.0, 95.0), (110.0, 105.0), (108.0, 105.0)])
    result = convert_map(road.write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    picture, view = tmp_path / "gui.png", tmp_path / "view.xml"
    view.write_text(
        '<viewsettings><scheme name="real world"/><delay value="50"/>'
        f'<snapshot file="{picture}" time="2"/></viewsettings>',
        encoding="utf-8",
    )
    command = [screen, "-a", gui, "-n", result.net, "-a", result.sidecar, "--gui-settings-file", view]
    run([*command, "--window-size", "600,600", "--start", "--quit-on-end", "-e", "5"])
    from matplotlib.image import imread  # late: only where a window can be opened

    shown = np.round(255.0 * np.asarray(imread(picture))[..., :3]).astype(int).reshape(-1, 3)
    colours = {tuple(colour) for colour in np.unique(shown, axis=0).tolist()}
    assert (230, 230, 230) in colours  # the crossing of the side-car
    assert (51, 51, 51) in colours  # the asphalt of the net
