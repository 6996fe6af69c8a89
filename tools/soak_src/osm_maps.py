"""Small invented maps in the format of OpenStreetMap, and their conversion to nets by netconvert."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import sumo
import sumolib

Tags = Mapping[str, str]
Point = tuple[float, float]

_LAT_DEG, _LON_DEG = 52.5, 13.4
_M_PER_DEG = 111_320.0
_TYPES = ("osmNetconvert.typ.xml", "osmNetconvertUrbanDe.typ.xml", "osmNetconvertBicycle.typ.xml")
#: Options of netconvert that SUMO's guide recommends for OpenStreetMap data.
_OPTIONS = (
    *("--geometry.remove", "--roundabouts.guess", "--ramps.guess", "--junctions.join"),
    *("--tls.guess-signals", "--tls.discard-simple", "--tls.join", "--no-warnings"),
)


@dataclass
class OsmMap:
    """Nodes at metres east and north of a place, and ways through them."""

    nodes: dict[Point, int] = field(default_factory=dict)
    tags: dict[Point, Tags] = field(default_factory=dict)
    ways: list[tuple[list[Point], Tags]] = field(default_factory=list)

    def way(self, points: Iterable[Point], **tags: str) -> None:
        """Add a way; ``_`` in a key stands for ``:``."""
        corners = [(float(x), float(y)) for x, y in points]
        for corner in corners:
            self.nodes.setdefault(corner, len(self.nodes) + 1)
        self.ways.append((corners, {key.replace("_", ":"): value for key, value in tags.items()}))

    def xml(self) -> str:
        """Return the map as XML."""
        lines = ['<?xml version="1.0" encoding="UTF-8"?>', '<osm version="0.6">']
        scale = _M_PER_DEG * float(np.cos(np.radians(_LAT_DEG)))
        for (x, y), number in self.nodes.items():
            place = f'lat="{_LAT_DEG + y / _M_PER_DEG:.8f}" lon="{_LON_DEG + x / scale:.8f}"'
            lines.append(f'<node id="{number}" version="1" {place}>{_tags(self.tags.get((x, y), {}))}</node>')
        for number, (corners, tags) in enumerate(self.ways, 10_000):
            refs = "".join(f'<nd ref="{self.nodes[corner]}"/>' for corner in corners)
            lines.append(f'<way id="{number}" version="1">{refs}{_tags(tags)}</way>')
        return "\n".join([*lines, "</osm>"])


def _tags(tags: Tags) -> str:
    return "".join(f"<tag k={quoteattr(key)} v={quoteattr(value)}/>" for key, value in tags.items())


def _one_way_grid() -> OsmMap:
    """Return a grid of four by four streets; along x, every second street is one-way, and directions alternate."""
    town = OsmMap()
    steps = [100.0 * k for k in range(4)]
    for k, c in enumerate(steps):
        along = [(x, c) for x in steps]
        town.way(along if k % 4 == 1 else along[::-1], highway="residential", oneway="yes" if k % 2 else "no")
        town.way([(c, y) for y in steps], highway="tertiary", maxspeed="50", lanes="2")
    return town


def _roundabout() -> OsmMap:
    """Return a roundabout of 20 m radius with four streets."""
    town = OsmMap()
    angles = np.radians(np.arange(0.0, 361.0, 30.0))
    ring = [
        (round(20.0 * float(np.cos(a)), 3) + 0.0, round(20.0 * float(np.sin(a)), 3) + 0.0) for a in angles
    ]
    ring[-1] = ring[0]
    town.way(ring, highway="secondary", junction="roundabout")
    for k in (0, 3, 6, 9):
        x, y = ring[k]
        town.way([(10.0 * x, 10.0 * y), (x, y)], highway="secondary", maxspeed="50")
    return town


def _signals() -> OsmMap:
    """Return an avenue with two lanes in each direction, turning lanes, and three junctions with signals."""
    town = OsmMap()
    xs = [0.0, 150.0, 300.0, 450.0, 600.0]
    town.way(
        [(x, 0.0) for x in xs],
        highway="primary",
        lanes="4",
        maxspeed="50",
        turn_lanes_forward="left;through|right",
    )
    for x in xs[1:-1]:
        town.way([(x, -150.0), (x, 0.0), (x, 150.0)], highway="secondary", lanes="2")
        town.tags[x, 0.0] = {"highway": "traffic_signals"}
    return town


def _cycleways() -> OsmMap:
    """Return streets with bicycle lanes and paths, a footpath, and a street for buses and bicycles only."""
    town = OsmMap()
    town.way([(0, 0), (200, 0), (400, 0)], highway="secondary", cycleway_right="lane", sidewalk="both")
    town.way([(200, -150), (200, 0), (200, 150)], highway="residential", cycleway="track")
    town.way([(200, 150), (400, 150), (400, 0)], highway="unclassified", bicycle="designated")
    town.way([(0, 0), (200, 150)], highway="cycleway", foot="no")
    town.way([(200, -150), (400, 0)], highway="footway")
    town.way([(0, 0), (0, -150), (200, -150)], highway="service", access="no", bus="yes", bicycle="yes")
    return town


def _rail() -> OsmMap:
    """Return a railway with a level crossing, a street with a tram, and a motorway with a ramp."""
    town = OsmMap()
    town.way([(-200, 0), (0, 0), (200, 0), (400, 0)], highway="secondary", maxspeed="50")
    town.way([(0, -200), (0, 0), (0, 200)], railway="rail")
    town.tags[0.0, 0.0] = {"railway": "level_crossing"}
    town.way([(200, -200), (200, 0), (200, 200)], highway="residential", railway="tram")
    town.way([(-400, 300), (0, 320), (600, 320)], highway="motorway", lanes="2", oneway="yes", maxspeed="120")
    town.way([(200, 200), (300, 300), (600, 320)], highway="motorway_link", oneway="yes")
    return town


OSM_MAPS: Mapping[str, Callable[[], OsmMap]] = {
    "osm-one-ways": _one_way_grid,
    "osm-roundabout": _roundabout,
    "osm-signals": _signals,
    "osm-cycleways": _cycleways,
    "osm-rail": _rail,
}
"""The maps by name."""


def write_osm_net(name: str, net: Path) -> None:
    """Convert the map *name* into the file *net*; its OpenStreetMap file is written beside it.

    Raises:
        subprocess.CalledProcessError: netconvert failed.
    """
    source = net.with_name(f"{name}.osm.xml")
    source.write_text(OSM_MAPS[name]().xml(), encoding="utf-8")
    types = ",".join(str(Path(sumo.SUMO_HOME) / "data" / "typemap" / file) for file in _TYPES)
    words = [sumolib.checkBinary("netconvert"), "--osm-files", str(source), "--type-files", types]
    subprocess.run([*words, *_OPTIONS, "-o", str(net)], check=True, capture_output=True, text=True)
