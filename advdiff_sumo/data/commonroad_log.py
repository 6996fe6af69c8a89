"""Reads the road users of CommonRoad scenarios 2020a (Althoff et al. 2017, DOI 10.1109/IVS.2017.7995802)."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import LogError
from advdiff_sumo.core.gzipped import DAMAGED_GZIP, unpacked
from advdiff_sumo.core.map_files import load_xml
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.log_reader import LogScene
from advdiff_sumo.data.motion import annotated_tracks, parked_agents
from advdiff_sumo.data.scene_files import SceneFiles

CLASSES = {
    "car": AgentClass.CAR,
    "taxi": AgentClass.CAR,
    "priorityVehicle": AgentClass.CAR,
    "truck": AgentClass.TRUCK,
    "bus": AgentClass.BUS,
    "motorcycle": AgentClass.MOTORCYCLE,
    "bicycle": AgentClass.BICYCLE,
    "pedestrian": AgentClass.PEDESTRIAN,
}
SUFFIXES = (".xml", ".xml.gz")
_SAME_POSITION_M = 0.1  # obstacles within this distance of a planning problem's start are at it
_HEAD_BYTES = 65_536  # the root element is sought in these
_AGAIN = "give an unchanged CommonRoad scenario of version 2020a"


class CommonRoadReader(SceneFiles):
    """Reads one scenario (``.xml``, ``.xml.gz``) or those of a folder; a scene has the name of its file.

    A scenario has no recording vehicle. The ego is the obstacle at the start of a planning problem, or else the
    vehicle that drives farthest. Obstacles without a trajectory, or with occupancy sets only, are left out.
    """

    kind, remedy = "scenario", _AGAIN

    def read_file(self, name: str, path: Path) -> LogScene:
        """Return the scenario in *path*."""
        return _scene(name, path, load_xml(path))

    def paths(self) -> dict[Path, str]:
        """Return file → name of every scenario."""
        if self.path.is_file():
            paths = [self.path]
        else:
            paths = [path for path in sorted(self.path.iterdir()) if is_scenario(path)]
        if not paths:
            raise LogError(self.path, "no such file or folder of CommonRoad scenarios", "give one of these")
        return {path: path.name.split(".")[0] for path in paths}


def is_scenario(path: Path) -> bool:
    """Return whether *path* is a scenario, by its first bytes; also True for damaged files with a fitting suffix."""
    if not (path.name.endswith(SUFFIXES) and path.is_file()):
        return False
    try:
        with unpacked(path) as file:
            return b"<commonRoad" in file.read(_HEAD_BYTES)
    except (OSError, *DAMAGED_GZIP):
        return True  # its reader will say what is wrong with it


def _scene(name: str, path: Path, root: Element) -> LogScene:
    if root.tag != "commonRoad":
        raise ValueError(f"it begins with <{root.tag}>, not <commonRoad>")
    dt_s = float(root.attrib["timeStepSize"])
    obstacles = [*root.iterfind("dynamicObstacle"), *root.iterfind("obstacle")]  # the latter in version 2018b
    rows = [row for row in obstacles if _has_track(row)]
    if not rows:
        raise ValueError("no obstacle has a trajectory, so there is nobody to drive")
    states = [_states(row) for row in rows]
    tracks = _tracks(rows, states, dt_s)
    parked = parked_agents(tracks.xy_m, tracks.valid, tracks.dt_s)
    ego = _planned_for(root, tracks)
    if ego is None:
        driven_m = np.nansum(np.hypot(*np.moveaxis(np.diff(tracks.xy_m, axis=1), -1, 0)), axis=1)
        driven_m[tracks.classes >= AgentClass.BICYCLE] = -1.0
        ego = int(driven_m.argmax())
    parked[ego] = False
    return LogScene(name, root.get("benchmarkID", name), tracks, ego, parked, path)


def _planned_for(root: Element, tracks: Tracks) -> int | None:
    """Return the row of the obstacle at the initial state of a planning problem; None if there is none."""
    for start in root.iterfind("planningProblem/initialState"):
        step = round(_number(start, "time"))
        if start.find("position/point") is None or not 0 <= step < tracks.steps:
            continue
        with np.errstate(invalid="ignore"):
            distance_m = np.hypot(*(tracks.xy_m[:, step] - _xy(start)).T)
        at_start = np.flatnonzero(distance_m < _SAME_POSITION_M)  # NaN compares as False
        if len(at_start):
            return int(at_start[0])
    return None


def _class_of(row: Element) -> AgentClass | None:
    return CLASSES.get((row.findtext("type") or "").strip())


def _has_track(row: Element) -> bool:
    return (
        _class_of(row) is not None and row.find("trajectory/state") is not None and _size_m(row) is not None
    )


def _size_m(row: Element) -> tuple[float, float] | None:
    """Return length and width in m of an obstacle's rectangle, circle or polygon; None without a shape."""
    box = row.find("shape/rectangle")
    if box is not None:
        return float(box.findtext("length") or "nan"), float(box.findtext("width") or "nan")
    radius = row.findtext("shape/circle/radius")
    if radius is not None:
        return 2.0 * float(radius), 2.0 * float(radius)
    corners = [
        (float(point.findtext("x") or "nan"), float(point.findtext("y") or "nan"))
        for point in row.iterfind("shape/polygon/point")
    ]
    if not corners:
        return None
    length, width = np.ptp(np.array(corners), axis=0).tolist()
    return length, width


def _states(row: Element) -> FloatArray:
    """Return the K states of an obstacle as rows (K, 4): step, x and y in m, orientation in rad."""
    elements = [*row.iterfind("initialState"), *row.iterfind("trajectory/state")]
    return np.array([[_number(s, "time"), *_xy(s), _number(s, "orientation")] for s in elements])


def _number(state: Element, tag: str) -> float:
    """Return the value of *tag* in a state, or the middle of its interval."""
    text = state.findtext(f"{tag}/exact")
    if text is not None:
        return float(text)
    low, high = state.findtext(f"{tag}/intervalStart"), state.findtext(f"{tag}/intervalEnd")
    if low is None or high is None:
        raise ValueError(f"a state has no {tag}")
    return 0.5 * (float(low) + float(high))


def _xy(state: Element) -> tuple[float, float]:
    point = state.find("position/point")
    if point is None:
        raise ValueError("a state has no point as its position")
    return float(point.findtext("x") or "nan"), float(point.findtext("y") or "nan")


def _tracks(rows: list[Element], states: list[FloatArray], dt_s: float) -> Tracks:
    """Return the tracks of the obstacles *rows* with *states* (K, 4) each."""
    steps = int(max(obstacle_states[:, 0].max() for obstacle_states in states)) + 1
    xy = np.full((len(rows), steps, 2), np.nan)
    yaw = np.full((len(rows), steps), np.nan)
    for number, obstacle_states in enumerate(states):
        if not np.isfinite(obstacle_states).all():
            raise ValueError(f"a state of obstacle {rows[number].get('id')} is not finite")
        steps_of = np.rint(obstacle_states[:, 0]).astype(np.int64)
        if steps_of.min() < 0 or len(np.unique(steps_of)) < len(steps_of):
            raise ValueError(
                f"obstacle {rows[number].get('id')} has states before step 0, or two of one step"
            )
        xy[number, steps_of], yaw[number, steps_of] = obstacle_states[:, 1:3], obstacle_states[:, 3]
    sizes = [size for row in rows if (size := _size_m(row)) is not None]
    ids = (row.get("id", "") for row in rows)
    return annotated_tracks(ids, [_class_of(row) for row in rows], np.array(sizes), xy, yaw, dt_s)
