"""A small crossing, and records of cars driven by hand on it."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import sumolib

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps import RoadMap

NODES = """<nodes>
  <node id="W" x="-200" y="0"/> <node id="E" x="200" y="0"/> <node id="N" x="0" y="200"/> <node id="S" x="0" y="-200"/>
  <node id="C" x="0" y="0" type="{kind}"/>
</nodes>"""
EDGES = """<edges>
  <edge id="WC" from="W" to="C" numLanes="2" priority="5"/> <edge id="CE" from="C" to="E" numLanes="2" priority="5"/>
  <edge id="EC" from="E" to="C" numLanes="2" priority="5"/> <edge id="CW" from="C" to="W" numLanes="2" priority="5"/>
  <edge id="SC" from="S" to="C" numLanes="1" priority="1"/> <edge id="CN" from="C" to="N" numLanes="1" priority="1"/>
  <edge id="NC" from="N" to="C" numLanes="1" priority="1"/> <edge id="CS" from="C" to="S" numLanes="1" priority="1"/>
</edges>"""


@dataclass(frozen=True)
class Car:
    """A car at T instants: centres (T, 2), headings (T,), speeds (T,)."""

    name: str
    xy_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray
    size_m: tuple[float, float] = (4.0, 2.0)


def crossing(folder: Path, kind: str) -> RoadMap:
    """Make a crossing of a 2 x 2 lane street along x and a 2 x 1 lane one along y; lanes are 3.2 m wide."""
    (folder / "n.nod.xml").write_text(NODES.format(kind=kind))
    (folder / "e.edg.xml").write_text(EDGES)
    net = folder / f"{kind}.net.xml"
    files = ["-n", str(folder / "n.nod.xml"), "-e", str(folder / "e.edg.xml"), "-o", str(net)]
    options = ["--no-turnarounds", "true", "--offset.disable-normalization", "true", "--no-warnings", "true"]
    command = [sumolib.checkBinary("netconvert"), *files, *options]
    subprocess.run(command, check=True, capture_output=True)
    return RoadMap.read(net)


@pytest.fixture(scope="session")
def road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """The crossing with the street along x having priority."""
    return crossing(tmp_path_factory.mktemp("priority"), "priority")


@pytest.fixture(scope="session")
def light_road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """The crossing with traffic lights."""
    return crossing(tmp_path_factory.mktemp("light"), "traffic_light")


@pytest.fixture(scope="session")
def stop_road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """The crossing as an all-way stop."""
    return crossing(tmp_path_factory.mktemp("stop"), "allway_stop")


@pytest.fixture(scope="session")
def straight() -> Callable[..., Car]:
    """Return a maker of cars at constant velocity; *drift* is a sideways speed (left positive)."""

    def make(
        name: str,
        xy: tuple[float, float],
        yaw: float,
        speed: float,
        steps: int = 41,
        drift: float = 0.0,
        size: tuple[float, float] = (4.0, 2.0),
    ) -> Car:
        t = 0.1 * np.arange(steps)[:, None]
        ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
        path = np.asarray(xy) + t * (speed * ahead + drift * left)
        return Car(name, path, np.full(steps, float(yaw)), np.full(steps, float(speed)), size)

    return make


@pytest.fixture(scope="session")
def record_of() -> Callable[..., EpisodeRecord]:
    """Return a maker of records; the first car is the target; NaN positions mean absent."""

    def make(
        *cars: Car,
        route: tuple[str, ...] = ("WC", "CE"),
        signals: tuple[Mapping[str, str], ...] = (),
        **rest: object,
    ) -> EpisodeRecord:
        xy = np.stack([c.xy_m for c in cars])
        valid = np.isfinite(xy).all(-1)
        tracks = Tracks(
            ids=tuple(c.name for c in cars),
            classes=np.zeros(len(cars), dtype=np.int64),
            size_m=np.array([c.size_m for c in cars]),
            xy_m=xy,
            yaw_rad=np.where(valid, np.stack([c.yaw_rad for c in cars]), np.nan),
            speed_mps=np.where(valid, np.stack([c.speed_mps for c in cars]), np.nan),
            valid=valid,
            t0_s=0.0,
            dt_s=0.1,
        )
        controller = np.where(valid, Controller.POLICY, Controller.ABSENT).astype(np.int64)
        return EpisodeRecord(
            0, 1, "hand-made", tracks, 0, controller, route, EndReason.HORIZON, signals=signals, **rest
        )  # type: ignore[arg-type]  # keyword fields vary by test

    return make
