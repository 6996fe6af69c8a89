"""The lanes of a SUMO net as a source: what netconvert makes of OpenDRIVE."""

from __future__ import annotations

import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import sumolib

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats
from advdiff_sumo.maps.convert.sources.bounded_lanes import as_multi
from advdiff_sumo.maps.convert.sources.map_files import load_xml
from advdiff_sumo.maps.convert.sources.source_map import LaneUse, SourceLane, SourceMap

REMEDY = "give an unchanged OpenDRIVE file (.xodr)"
TIMEOUT_S = 600
RESOLUTION_M = 0.25  # of curves


def opendrive_map(path: Path) -> SourceMap:
    """Return the lanes that netconvert reads from the OpenDRIVE file *path*.

    A lane is named "road.section_lane" as netconvert names its edges, a way through a junction by SUMO's internal
    lane. The drivable area is what lanes and ways cover at their widths.

    Raises:
        MapError: netconvert refuses the file, or it holds no lane for vehicles.
    """
    root = load_xml(path)
    if root.tag != "OpenDRIVE":
        raise MapError(path, f"begins with <{root.tag}>, so it is no OpenDRIVE file", REMEDY)
    with tempfile.TemporaryDirectory() as folder:
        net = Path(folder) / "x.net.xml"
        _import(path, net)
        rows = sumolib.net.readNet(str(net), withInternal=True)
        lanes = list(_lanes(rows))
        links = list(_links(rows, {lane.token for lane in lanes}))
    if not lanes:
        raise MapError(path, "holds no lane for vehicles", REMEDY)
    strips = [
        shapely.LineString(lane.centre_m).buffer(0.5 * (lane.width_m or 0.0), cap_style="flat")
        for lane in lanes
    ]
    return SourceMap(
        path=path,
        location=path.name.removesuffix(".gz").removesuffix(".xodr"),
        lanes=tuple(lanes),
        links=tuple(links),
        drivable=as_multi(shapely.union_all(strips)),
        notes=Counter(),
    )


def _import(path: Path, net: Path) -> None:
    command = [sumolib.checkBinary("netconvert"), "--opendrive-files", str(path), "-o", str(net)]
    command += ["--opendrive.curve-resolution", str(RESOLUTION_M), "--opendrive.internal-shapes", "true"]
    command += ["--offset.disable-normalization", "true", "--geometry.min-radius.fix", "false"]
    command += ["--no-turnarounds", "true", "--xml-validation", "never", "--precision", "4"]
    command += ["--opendrive.advance-stopline", "0"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        raise MapError(path, f"netconvert was not done after {TIMEOUT_S} s", REMEDY) from None
    if done.returncode != 0 or not net.exists():
        errors = [line for line in done.stderr.splitlines() if line.startswith("Error")]
        reason = errors[0].removeprefix("Error: ") if errors else "no reason given"
        raise MapError(path, f"is refused by netconvert ({reason})", REMEDY)


def _lanes(net: Any) -> Iterator[SourceLane]:
    for edge in net.getEdges():
        if edge.getFunction() not in ("", "internal"):
            continue
        for lane in edge.getLanes():
            use = _use(lane)
            centre = _line(lane)
            if use is not None and len(centre) > 1:
                yield SourceLane(
                    token=lane.getID(),
                    is_connector=edge.getFunction() == "internal",
                    centre_m=centre,
                    use=use,
                    speed_mps=float(lane.getSpeed()),
                    width_m=float(lane.getWidth()),
                )


def _use(lane: Any) -> LaneUse | None:
    if lane.allows("passenger"):
        return LaneUse.CAR
    return LaneUse.BUS if lane.allows("bus") else LaneUse.BICYCLE if lane.allows("bicycle") else None


def _line(lane: Any) -> FloatArray:
    return drop_repeats(np.asarray([point[:2] for point in lane.getShape()], dtype=np.float64))


def _links(net: Any, known: set[str]) -> Iterator[tuple[str, str]]:
    """Yield each step from a lane to an internal lane and from there on; straight to the next lane without one."""
    steps: dict[tuple[str, str], None] = {}
    for edge in net.getEdges():
        for lane in edge.getLanes():
            for connection in lane.getOutgoing():
                after = connection.getViaLaneID() or connection.getToLane().getID()
                if after not in known:
                    after = connection.getToLane().getID()
                steps[lane.getID(), after] = None
    yield from (step for step in steps if set(step) <= known)
