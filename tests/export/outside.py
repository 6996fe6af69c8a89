"""Other people's programs on what is exported, and what their answers must be.

SUMO's own are always there. The rest live in environments of their own, which ``make readers`` makes:
commonroad-io with commonroad-crime, and ASAM's checkers qc_openscenario and qc_opendrive.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import sumolib
from defusedxml import ElementTree

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.export import ExportScene
from advdiff_sumo.export.export_check import HEADING_RAD, POSITION_M
from tests.hang_guard import HANG_S

ROOT = Path(__file__).resolve().parents[2]
COMMONROAD_READER = """
import json, sys, traceback
from commonroad.common.file_reader import CommonRoadFileReader
from commonroad import scenario_definition
def read(path, steps):
    scenario, problems = CommonRoadFileReader(path).open(lanelet_assignment=True)
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
    if steps:
        from commonroad_crime.data_structure.configuration import CriMeConfiguration
        from commonroad_crime.measure import TTC
        from commonroad.scenario.lanelet import LaneletNetwork
        start = problem.initial_state
        everybody = scenario.dynamic_obstacles
        ego = min(everybody, key=lambda o: abs(o.initial_state.position - start.position).sum()).obstacle_id
        other = min(o.obstacle_id for o in everybody)
        # its gaps and speeds (0.4) are right along x alone, as it adds half a length to both x and y and takes a cosine
        scenario.translate_rotate(-start.position, 0.0)
        scenario.translate_rotate(0.0 * start.position, -start.orientation)
        # turning leaves the index of places as it was
        scenario.replace_lanelet_network(LaneletNetwork.create_from_lanelet_list(scenario.lanelet_network.lanelets))
        config = CriMeConfiguration()
        config.vehicle.ego_id = ego
        config.update(ego_id=ego, sce=scenario)
        found["ttc"] = [float(TTC(config).compute(other, t, verbose=False)) for t in steps]
    return found
for line in sys.stdin:
    try:
        print("FOUND" + json.dumps(read(*json.loads(line))), flush=True)
    except Exception:
        print(traceback.format_exc() + "FAILED", flush=True)
"""


def reader(environment: str, program: str) -> str:
    """Return a program of an environment of ``make readers``, or skip."""
    path = ROOT / "build" / "readers" / environment
    if not (path / ".ready").exists():
        pytest.skip("the outside readers are not installed: make readers")
    return str(path / "bin" / program)


class CommonRoadReader:
    """A process with commonroad-io that reads one scenario after the other, as its imports take seconds."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def __call__(self, path: Path, *steps: int) -> dict[str, object]:
        """Return what commonroad-io reads, and commonroad-crime's TTC of target and first obstacle at *steps*."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([str(path), steps]) + "\n")
        self._process.stdin.flush()
        said = []
        for line in self._process.stdout:
            if line.startswith("FOUND"):
                found: dict[str, object] = json.loads(line.removeprefix("FOUND"))
                return found
            said.append(line)
            if line.startswith("FAILED"):
                break
        pytest.fail("".join(said))


@contextmanager
def commonroad_reader() -> Iterator[CommonRoadReader]:
    """Give a reader as long as it is needed, or skip."""
    command = [reader("commonroad", "python"), "-c", COMMONROAD_READER]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(command, text=True, **pipes) as process:
        yield CommonRoadReader(process)


def same_obstacles(found: dict[str, object], scene: ExportScene) -> tuple[float, float]:
    """Compare everybody that commonroad-io read with *scene*; return the greatest distance in m and turn in rad."""
    tracks = scene.tracks
    seen = np.zeros_like(tracks.valid)
    apart, turned = [0.0], [0.0]
    for obstacle in found["obstacles"]:  # type: ignore[attr-defined]  # JSON
        states = np.array(obstacle["states"])
        step = states[:, 0].astype(int)
        gaps = np.hypot(*np.moveaxis(tracks.xy_m[:, step] - states[:, 1:3], -1, 0)).max(axis=-1)
        row = int(np.nanargmin(gaps))
        assert AgentClass(int(tracks.classes[row])).name.lower() == obstacle["type"]
        assert obstacle["size"] == pytest.approx(tracks.size_m[row].tolist())
        assert np.abs(states[:, 4] - tracks.speed_mps[row, step]).max() <= 0.01
        apart.append(np.hypot(*(states[:, 1:3] - tracks.xy_m[row, step]).T).max())
        turned.append(np.abs(wrap_angle(states[:, 3] - tracks.yaw_rad[row, step])).max())
        seen[row, step] = True
    assert (seen == tracks.valid).all()
    assert max(apart) <= POSITION_M
    assert max(turned) <= HEADING_RAD
    return max(apart), max(turned)


def quality(program: str, bundle: str, path: Path, folder: Path) -> list[str | None]:
    """Return what a checker of ASAM finds in *path*; it must complete its checks."""
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
    states = [check.get("status") for check in root.iter("Checker")]
    assert states.count("completed") >= 15
    assert "error" not in states
    return [issue.get("description") for issue in root.iter("Issue")]


def netconverted(roads: Path, folder: Path) -> sumolib.net.Net:
    """Return the net that netconvert makes of an OpenDRIVE file."""
    net = folder / "again.net.xml"
    command = [sumolib.checkBinary("netconvert"), "--opendrive-files", str(roads), "-o", str(net)]
    command += ["--offset.disable-normalization", "true", "--opendrive.import-all-lanes", "true"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=HANG_S)
    assert done.returncode == 0, done.stderr
    return sumolib.net.readNet(str(net))


def states_of(path: Path) -> dict[tuple[str, float], list[float]]:
    """Return (vehicle, time) → x, y, angle of an FCD file."""
    return {
        (agent.get("id"), round(float(instant.get("time")), 3)): [
            float(agent.get(key)) for key in ("x", "y", "angle")
        ]
        for instant in ElementTree.fromstring(path.read_bytes()).iter("timestep")
        for agent in instant
    }


def played(config: Path) -> dict[tuple[str, float], list[float]]:
    """Return (vehicle, time) → x, y, angle that SUMO has when it plays a configuration."""
    command = [sumolib.checkBinary("sumo"), "-c", config.name]
    command += ["--fcd-output", "played.xml", "--precision", "4"]
    done = subprocess.run(
        command, cwd=config.parent, capture_output=True, text=True, check=False, timeout=HANG_S
    )
    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr
    return states_of(config.parent / "played.xml")
