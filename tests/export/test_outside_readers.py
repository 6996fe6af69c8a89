"""Other people's programs read what is exported.

SUMO's own are always there. The rest live in environments of their own, which ``make readers`` makes:
commonroad-io with commonroad-crime, and ASAM's checkers qc_openscenario and qc_opendrive. sumo-gui needs a display,
for which Debian's xvfb will do.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import sumolib
from defusedxml import ElementTree
from lxml import etree

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data import ScenarioNetReader
from advdiff_sumo.data.pickles import load_plain
from advdiff_sumo.export import ExportScene, make_exporter
from advdiff_sumo.maps.convert import convert_map
from advdiff_sumo.maps.convert.scenarionet_map import read_record_map
from advdiff_sumo.metrics.criticality import time_to_collision
from advdiff_sumo.metrics.following import following
from advdiff_sumo.sim.logs import LoggedTraffic
from advdiff_sumo.sim.options import SceneOptions, SimOptions
from tests.sim import nets

ROOT = Path(__file__).resolve().parents[2]
SUMO_HOME = Path(sumolib.checkBinary("netconvert")).resolve().parents[1]
COMMONROAD_READER = """
import json, sys
from commonroad.common.file_reader import CommonRoadFileReader
from commonroad import scenario_definition
scenario, problems = CommonRoadFileReader(sys.argv[1]).open(lanelet_assignment=True)
rows = []
for obstacle in scenario.dynamic_obstacles:
    states = [obstacle.initial_state]
    if obstacle.prediction is not None:
        states += obstacle.prediction.trajectory.state_list
    box = obstacle.obstacle_shape
    rows.append({"type": obstacle.obstacle_type.value, "size": [box.length, box.width],
        "states": [[s.time_step, *map(float, s.position), s.orientation, s.velocity] for s in states]})
(problem,) = problems.planning_problem_dict.values()
net = scenario.lanelet_network
found = {"dt": scenario.dt, "id": str(scenario.scenario_id), "obstacles": rows,
    "lanelets": len(net.lanelets), "links": sum(len(x.successor) for x in net.lanelets),
    "start": [*map(float, problem.initial_state.position), problem.initial_state.velocity],
    "schema": str(scenario_definition.__path__[0])}
if len(sys.argv) > 2:
    from commonroad_crime.data_structure.configuration import CriMeConfiguration
    from commonroad_crime.measure import TTC
    other, ego = sorted(o.obstacle_id for o in scenario.dynamic_obstacles)
    config = CriMeConfiguration()
    config.vehicle.ego_id = ego
    config.update(ego_id=ego, sce=scenario)
    found["ttc"] = [float(TTC(config).compute(other, t, verbose=False)) for t in map(int, sys.argv[2:])]
print("FOUND" + json.dumps(found))
"""


def reader(environment: str, program: str) -> str:
    """Return a program of an environment of ``make readers``, or skip."""
    path = ROOT / "build" / "readers" / environment
    if not (path / ".ready").exists():
        pytest.skip("the outside readers are not installed: make readers")
    return str(path / "bin" / program)


def commonroad(path: Path, *steps: int) -> dict[str, object]:
    """Return what commonroad-io reads, and the TTC of commonroad-crime at *steps*."""
    command = [reader("commonroad", "python"), "-c", COMMONROAD_READER, str(path), *map(str, steps)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    found: dict[str, object] = json.loads(done.stdout.partition("FOUND")[2])
    return found


def test_commonroad_io_reads_everybody(busy: ExportScene, tmp_path: Path) -> None:
    found = commonroad(make_exporter("commonroad").write(busy, tmp_path)[0])
    tracks = busy.tracks
    assert found["dt"] == tracks.dt_s
    assert str(found["id"]).startswith("ZAM_CrossingPriority-1_1_T-1")
    assert found["start"] == pytest.approx([-30.0, -1.6, 8.0])
    assert found["lanelets"] == len(busy.lanes)
    assert found["links"] == len(busy.joints({lane.id for lane in busy.lanes})) > 0
    seen = np.zeros_like(tracks.valid)
    for obstacle in found["obstacles"]:  # type: ignore[attr-defined]  # JSON
        states = np.array(obstacle["states"])
        step = states[:, 0].astype(int)
        gaps = np.hypot(*(tracks.xy_m[:, step[0]] - states[0, 1:3]).T)
        row = int(np.nanargmin(gaps))
        assert AgentClass(int(tracks.classes[row])).name.lower() == obstacle["type"]
        assert obstacle["size"] == pytest.approx(tracks.size_m[row].tolist())
        assert np.abs(states[:, 1:3] - tracks.xy_m[row, step]).max() <= 0.01
        assert np.abs(wrap_angle(states[:, 3] - tracks.yaw_rad[row, step])).max() <= np.deg2rad(0.1)
        assert np.abs(states[:, 4] - tracks.speed_mps[row, step]).max() <= 0.01
        seen[row, step] = True
    assert (seen == tracks.valid).all()


def test_commonroad_keeps_its_schema(plain: ExportScene, busy: ExportScene, tmp_path: Path) -> None:
    """Late arrivals break one rule of it, that obstacles begin at 0; commonroad-io writes them so itself."""
    path = make_exporter("commonroad").write(plain, tmp_path)[0]
    folder = Path(str(commonroad(path)["schema"])) / "xml_definition_files"
    schema = etree.XMLSchema(etree.parse(folder / "XML_commonRoad_XSD.xsd"))
    assert schema.validate(etree.parse(path)), schema.error_log
    assert not schema.validate(etree.parse(make_exporter("commonroad").write(busy, tmp_path)[0]))
    late = "is greater than the maximum value allowed ('0')"
    lone = "Expected is one of ( initialSignalState, trajectory, occupancySet )"
    said = [error.message for error in schema.error_log]
    assert (
        len(said) == 5
    )  # late, twice, for an instant: late; for an instant, at first only: nothing to drive
    assert all(late in message or lone in message for message in said), said


def test_commonroad_crime_agrees_on_ttc(plain: ExportScene, tmp_path: Path) -> None:
    """It rounds to 0.01 s; the leader keeps 4 m/s, the target 12 m/s: (25 − 8 t) / 8."""
    steps = (0, 5, 10, 20)
    found = commonroad(make_exporter("commonroad").write(plain, tmp_path)[0], *steps)
    ours = time_to_collision(plain.tracks, plain.target)[0, list(steps)]
    lane = following(plain.tracks, plain.target, plain.road, ()).time_to_collision()[0, list(steps)]
    assert ours == pytest.approx([3.125 - 0.1 * step for step in steps])
    assert lane == pytest.approx(ours)
    assert found["ttc"] == pytest.approx(ours, abs=0.01)


def quality(program: str, bundle: str, path: Path, folder: Path) -> None:
    """Run a checker of ASAM on *path*; it must complete its checks and find nothing."""
    checker = reader("asam", program)
    report = folder / f"{path.suffix[1:]}.xqar"
    config = folder / f"{path.suffix[1:]}.xml"
    config.write_text(
        f'<Config><Param name="InputFile" value="{path}"/><CheckerBundle application="{bundle}">'
        f'<Param name="resultFile" value="{report}"/></CheckerBundle></Config>'
    )
    done = subprocess.run([checker, "-c", str(config)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    root = ElementTree.fromstring(report.read_bytes())
    assert [issue.get("description") for issue in root.iter("Issue")] == []
    states = [check.get("status") for check in root.iter("Checker")]
    assert states.count("completed") >= 15
    assert "error" not in states


def test_the_checker_of_openscenario_finds_nothing(busy: ExportScene, tmp_path: Path) -> None:
    quality("qc_openscenario", "xoscBundle", make_exporter("openscenario").write(busy, tmp_path)[0], tmp_path)


def test_the_checker_of_opendrive_finds_nothing(busy: ExportScene, tmp_path: Path) -> None:
    quality("qc_opendrive", "xodrBundle", make_exporter("openscenario").write(busy, tmp_path)[1], tmp_path)


def netconverted(roads: Path, folder: Path) -> sumolib.net.Net:
    """Return the net that netconvert makes of an OpenDRIVE file."""
    net = folder / "again.net.xml"
    command = [sumolib.checkBinary("netconvert"), "--opendrive-files", str(roads), "-o", str(net)]
    command += ["--offset.disable-normalization", "true", "--opendrive.import-all-lanes", "true"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return sumolib.net.readNet(str(net))


def test_netconvert_reads_the_roads(busy: ExportScene, tmp_path: Path) -> None:
    again = netconverted(make_exporter("openscenario").write(busy, tmp_path)[1], tmp_path)
    assert len(again.getEdges()) == 8
    assert sum(len(edge.getOutgoing()) for edge in again.getEdges()) == 12


@pytest.mark.data
@pytest.mark.slow
def test_a_converted_map(adv_data: Path, on_net: Callable[[Path], ExportScene], tmp_path: Path) -> None:
    source = adv_data / "nuscenes-mini" / "maps" / "expansion" / "singapore-onenorth.json"
    net = convert_map(source, tmp_path / "onenorth.net.xml").net
    scene = on_net(net)
    again = netconverted(make_exporter("openscenario").write(scene, tmp_path)[1], tmp_path)
    assert len(again.getEdges()) == sum(
        len(e.lane_ids) for e in scene.road.edges.values() if not e.is_internal
    )
    found = commonroad(make_exporter("commonroad").write(scene, tmp_path)[0])
    assert found["lanelets"] == len(scene.lanes)


def states_of(path: Path) -> dict[tuple[str, float], list[float]]:
    """Return (vehicle, time) → x, y, angle of an FCD file."""
    return {
        (agent.get("id"), round(float(instant.get("time")), 3)): [
            float(agent.get(key)) for key in ("x", "y", "angle")
        ]
        for instant in ElementTree.fromstring(path.read_bytes()).iter("timestep")
        for agent in instant
    }


def test_sumo_plays_the_configuration(busy: ExportScene, tmp_path: Path) -> None:
    """Who drives on the road is where and when the data have it (see docs/exports.md on the others)."""
    data, _, config, _ = make_exporter("fcd").write(busy, tmp_path)
    command = [
        sumolib.checkBinary("sumo"),
        "-c",
        config.name,
        "--fcd-output",
        "played.xml",
        "--precision",
        "4",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr
    written, played = states_of(data), states_of(tmp_path / "played.xml")
    for name in ("target", "agent_1", "gone:early"):
        steps = [key for key in written if key[0] == name]
        assert len(steps) >= 12
        for key in steps:
            assert played[key][:2] == pytest.approx(written[key][:2], abs=0.01)
            assert wrap_angle(np.deg2rad(played[key][2] - written[key][2])) == pytest.approx(0.0, abs=1e-3)


def test_sumo_gui_plays_the_configuration(busy: ExportScene, tmp_path: Path) -> None:
    """The window opens with network, lines and replayed vehicles, plays to the end and closes without a complaint."""
    display = [] if os.environ.get("DISPLAY") else [shutil.which("xvfb-run"), "--auto-servernum"]
    if None in display:
        pytest.skip("no display here: apt-get install xvfb")
    config = make_exporter("fcd").write(busy, tmp_path)[2]
    command = [*display, sumolib.checkBinary("sumo-gui"), "-c", config.name, "--start", "--quit-on-end"]
    command += ["--delay", "0", "--fcd-output", "played.xml", "--precision", "4"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)
    if "error while loading shared libraries" in done.stderr:
        pytest.skip(f"sumo-gui lacks a library of the system: {done.stderr.strip()}")
    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr
    assert {name for name, _ in states_of(tmp_path / "played.xml")} >= {"target", "agent_1", "gone:early"}


def test_sumo_s_schemas(busy: ExportScene, tmp_path: Path) -> None:
    files = make_exporter("fcd").write(busy, tmp_path)
    for path, name in zip(files, ("fcd_file", "additional_file", "sumoConfiguration"), strict=False):
        schema = etree.XMLSchema(etree.parse(SUMO_HOME / "data" / "xsd" / f"{name}.xsd"))
        assert schema.validate(etree.parse(path)), schema.error_log


def plain_types(value: object) -> bool:
    """Return whether MetaDrive's check of types passes (its ALLOW_TYPES, recursively)."""
    if isinstance(value, dict):
        return all(isinstance(key, str) and plain_types(item) for key, item in value.items())
    if isinstance(value, list | tuple):
        return all(plain_types(item) for item in value)
    return isinstance(value, int | float | str | np.ndarray | type(None))


def test_the_record_has_what_metadrive_asks_for(busy: ExportScene, tmp_path: Path) -> None:
    """The rules of ScenarioDescription.sanity_check with valid_check, MetaDrive 0.4."""
    path = make_exporter("scenarionet").write(busy, tmp_path)[0]
    record = load_plain(path)
    assert path.name.startswith("sd_")
    assert {"id", "version", "length", "tracks", "dynamic_map_states", "map_features"} < record.keys()
    assert {"ts", "metadrive_processed", "coordinate", "sdc_id"} < record["metadata"].keys()
    assert plain_types(record)
    length = record["length"]
    assert record["metadata"]["ts"].shape == (length,)
    for name, track in record["tracks"].items():
        assert track["type"] in {"VEHICLE", "CYCLIST", "PEDESTRIAN"}
        assert track["metadata"]["object_id"] == name
        valid = track["state"]["valid"]
        assert valid.sum() >= 1
        for values in track["state"].values():
            assert len(values) == length
            assert values.ndim in (1, 2)
            assert abs(values[..., :2][~valid].sum() if values.ndim == 2 else values[~valid].sum()) < 1e-2
    for feature in record["map_features"].values():
        assert feature["polyline"].shape[1] in (2, 3)


def test_the_record_is_a_log_and_a_map_of_ours(busy: ExportScene, tmp_path: Path) -> None:
    path = make_exporter("scenarionet").write(busy, tmp_path)[0]
    log = ScenarioNetReader(tmp_path).read(path.stem)
    assert log.tracks.ids[log.ego] == "target"
    source = read_record_map(load_plain(path), path)
    assert len(source.lanes) == len(busy.lanes) > 8
    assert len(source.links) == len(busy.joints({lane.id for lane in busy.lanes}))


def test_an_episode_can_start_from_the_record(on_net: Callable[..., ExportScene], tmp_path: Path) -> None:
    scene = on_net(nets.street(tmp_path), 101)
    make_exporter("scenarionet").write(scene, tmp_path)
    log = ScenarioNetReader(tmp_path)
    seeds = list(LoggedTraffic(scene.road, log, SceneOptions(), SimOptions(), SeedTree(0)).scenes())
    assert len(seeds) >= 1
    assert {seed.target for seed in seeds} == {"ego"}
    assert seeds[0].history.agents == 2


@pytest.mark.data
def test_the_record_has_the_keys_of_real_ones(adv_data: Path, busy: ExportScene, tmp_path: Path) -> None:
    ours = load_plain(make_exporter("scenarionet").write(busy, tmp_path)[0])
    for path in sorted((adv_data / "scenarionet").glob("sd_*.pkl")):
        real = load_plain(path)
        assert real.keys() <= ours.keys()
        theirs, mine = next(iter(real["tracks"].values())), next(iter(ours["tracks"].values()))
        assert theirs["state"].keys() <= mine["state"].keys()


def test_a_csv_is_a_csv(busy: ExportScene, tmp_path: Path) -> None:
    with make_exporter("csv").write(busy, tmp_path)[0].open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == int(busy.tracks.valid.sum())
    assert [row["time_s"] for row in rows] == sorted((row["time_s"] for row in rows), key=float)
    assert {row["agent"] for row in rows} == set(busy.tracks.ids)
    (first,) = [row for row in rows if row["agent"] == "target" and float(row["time_s"]) == 0.0]
    assert float(first["x_m"]) == -30.0
    assert first["is_target"] == "true"
