"""Tiny nets made by netconvert, and a stage that holds vehicles at given poses."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import sumolib

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import bumper_from_centre, centre_from_bumper, sumo_from_yaw, yaw_from_sumo
from advdiff_sumo.sim.session import Session, SessionOptions

LANE_M = 3.2
LENGTH_M, WIDTH_M = 5.0, 1.8
EAST, NORTH, WEST = 0.0, 0.5 * np.pi, np.pi
EXACTLY = 2  # moveToXY's keepRoute: the exact position, also off the net

STREET = (
    """<nodes><node id="W" x="0" y="0"/><node id="M" x="200" y="0"/><node id="E" x="400" y="0"/></nodes>""",
    """<edges>
<edge id="WM" from="W" to="M" numLanes="2" speed="14"/><edge id="ME" from="M" to="E" numLanes="2" speed="14"/>
<edge id="EM" from="E" to="M" numLanes="2" speed="14"/><edge id="MW" from="M" to="W" numLanes="2" speed="14"/>
</edges>""",
)
CROSSING = (
    """<nodes><node id="C" x="0" y="0" type="{kind}"/>
<node id="W" x="-150" y="0"/><node id="E" x="150" y="0"/><node id="N" x="0" y="150"/><node id="S" x="0" y="-150"/>
</nodes>""",
    """<edges>
<edge id="WC" from="W" to="C" speed="14" priority="2"/><edge id="CE" from="C" to="E" speed="14" priority="2"/>
<edge id="EC" from="E" to="C" speed="14" priority="2"/><edge id="CW" from="C" to="W" speed="14" priority="2"/>
<edge id="SC" from="S" to="C" speed="10" priority="1"/><edge id="CS" from="C" to="S" speed="10" priority="1"/>
<edge id="NC" from="N" to="C" speed="10" priority="1"/><edge id="CN" from="C" to="N" speed="10" priority="1"/>
</edges>""",
)
BEND_RADIUS_M = 60.0
BEND_CORNER_RAD = 0.5 * np.pi / 30  # between the straight pieces of its arc
TYPES = "types.add.xml"
CAR = f"""<additional>
<vType id="car" carFollowModel="IDM" length="{LENGTH_M}" width="{WIDTH_M}" sigma="0" speedDev="0"/>
<vType id="krauss" carFollowModel="Krauss" length="{LENGTH_M}" width="{WIDTH_M}" sigma="0" speedDev="0"/>
</additional>"""


def build(
    folder: Path,
    nodes: str,
    edges: str,
    name: str = "tiny",
    turnarounds: bool = False,
    lefthand: bool = False,
) -> Path:
    """Write a net from plain XML, coordinates as given."""
    (folder / f"{name}.nod.xml").write_text(nodes)
    (folder / f"{name}.edg.xml").write_text(edges)
    net = folder / f"{name}.net.xml"
    options = {
        "--node-files": folder / f"{name}.nod.xml",
        "--edge-files": folder / f"{name}.edg.xml",
        "--output-file": net,
        "--offset.disable-normalization": "true",
        "--no-turnarounds": str(not turnarounds).lower(),
        "--lefthand": str(lefthand).lower(),
        "--no-warnings": "true",
        "--xml-validation": "never",
    }
    words = [text for pair in options.items() for text in map(str, pair)]
    subprocess.run([sumolib.checkBinary("netconvert"), *words], check=True, capture_output=True)
    (folder / TYPES).write_text(CAR)
    return net


def street(folder: Path) -> Path:
    """A street along x from 0 to 400, two lanes each way: eastbound centres at y = −1.6 (left) and −4.8."""
    return build(folder, *STREET, name="street")


def crossing(folder: Path, kind: str = "priority") -> Path:
    """Single lanes that cross at the origin; the street along x has priority (if *kind* has priorities)."""
    return build(folder, CROSSING[0].format(kind=kind), CROSSING[1], name=f"crossing-{kind}")


def bend(folder: Path) -> Path:
    """One lane: 100 m east, a left quarter circle about (0, BEND_RADIUS_M), 100 m north."""
    angle = np.linspace(-0.5 * np.pi, 0.0, 31)
    arc = BEND_RADIUS_M * np.column_stack((np.cos(angle), 1.0 + np.sin(angle)))
    shape = " ".join(f"{x:.3f},{y:.3f}" for x, y in [(-100.0, 0.0), *arc, (BEND_RADIUS_M, 160.0)])
    nodes = f'<nodes><node id="A" x="-100" y="0"/><node id="B" x="{BEND_RADIUS_M}" y="160"/>'
    nodes += f'<node id="Z" x="{BEND_RADIUS_M}" y="300"/></nodes>'
    edges = f'<edges><edge id="AB" from="A" to="B" speed="14" spreadType="center" shape="{shape}"/>'
    edges += '<edge id="BZ" from="B" to="Z" speed="14" spreadType="center"/></edges>'
    return build(folder, nodes, edges, name="bend")


@dataclass(frozen=True)
class Started(SessionOptions):
    """The package's way to start SUMO, with some options changed.

    Attributes:
        otherwise: option → value, or None to omit it.
    """

    otherwise: Mapping[str, object] = field(default_factory=dict)

    def arguments(self) -> list[str]:
        """Return the command line."""
        words = super().arguments()
        options: dict[str, object] = dict(zip(words[::2], words[1::2], strict=True)) | dict(self.otherwise)
        pairs = ((name, value) for name, value in options.items() if value is not None)
        return [text for pair in pairs for text in map(str, pair)]


@dataclass
class Stage:
    """A running simulation with vehicles at given centres and headings.

    Attributes:
        api: libsumo.
        session: of the package.
        held: name → (centre, yaw) to which the vehicle is moved before every step.
        routes: number of routes made.
    """

    api: Any
    session: Session
    held: dict[str, tuple[FloatArray, float]] = field(default_factory=dict)
    routes: int = 0

    def add(
        self,
        name: str,
        edges: Sequence[str],
        *,
        lane: int = 0,
        at: float = 20.0,
        speed: float = 0.0,
        kind: str = "car",
    ) -> None:
        """Insert a car of LENGTH_M by WIDTH_M without random differences, its bumper *at* metres; SUMO does a step."""
        vehicle = self.api.vehicle
        self.routes += 1
        self.api.route.add(f"r{self.routes}", list(edges))
        where = {"departLane": str(lane), "departPos": str(at), "departSpeed": str(speed)}
        vehicle.add(name, f"r{self.routes}", typeID=kind, **where)
        self.step()
        if name not in vehicle.getIDList():
            raise AssertionError(f"{name} was not inserted")

    def free(self, name: str) -> None:
        """Switch off SUMO's checks of lane and speed for *name*."""
        self.api.vehicle.setSpeedMode(name, 0)
        self.api.vehicle.setLaneChangeMode(name, 0)

    def hold(self, name: str, x: float, y: float, yaw: float = EAST) -> None:
        """Keep the box centre of *name* at a pose from the next step on."""
        if name not in self.held:
            self.free(name)
        self.held[name] = np.array((x, y)), yaw

    def put(self, name: str, xy: FloatArray, yaw: float, keep_route: int = EXACTLY) -> None:
        """Move *name* in the next step."""
        x, y = bumper_from_centre(xy, np.asarray(yaw), np.asarray(LENGTH_M)).tolist()
        self.api.vehicle.moveToXY(name, "", -1, x, y, angle=float(sumo_from_yaw(yaw)), keepRoute=keep_route)

    def step(self) -> None:
        """Let SUMO do a step with all held vehicles in place."""
        for name, (xy, yaw) in self.held.items():
            self.put(name, xy, yaw)
        self.session.step()

    def pose(self, name: str) -> tuple[FloatArray, float]:
        """Return centre and yaw as SUMO has them."""
        yaw = yaw_from_sumo(self.api.vehicle.getAngle(name))
        bumper = np.array(self.api.vehicle.getPosition(name)[:2])
        return centre_from_bumper(bumper, yaw, np.asarray(LENGTH_M)), float(yaw)

    def reported(self) -> dict[frozenset[str], str]:
        """Return SUMO's own collisions of the last step: pair → type."""
        listed = self.api.simulation.getCollisions()
        return {frozenset((c.collider, c.victim)): c.type for c in listed}


@contextmanager
def stage(
    net: Path, *, sublane_m: float = 0.4, otherwise: Mapping[str, object] | None = None
) -> Iterator[Stage]:
    """Start SUMO on *net* as the package does."""
    types = (net.parent / TYPES,)
    options = Started(
        net, seed=1, lateral_resolution_m=sublane_m, additional=types, otherwise=otherwise or {}
    )
    with Session(options) as session:
        yield Stage(session.api, session)
