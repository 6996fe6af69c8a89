"""The motorway: two carriageways on either side of a service area, half interchanges, a weaving section.

There are no bridges: SUMO's plane has one level, and boxes that overlap are a collision. The service area in the median
connects the two directions instead.
"""

from __future__ import annotations

import numpy as np

from networks_src.carriageway import Carriageway, Ramp, Section, lay_carriageway, lay_ramps
from networks_src.curve import Curve
from networks_src.plain import Node, Plan, Points
from networks_src.streets import Street, lay
from networks_src.turns import connect

AXIS = Curve(
    np.array([(0, 0), (700, 50), (1400, 50), (2100, 0), (2800, -30), (3400, 10), (4000, 110)], dtype=float)
)
#: Distance of each carriageway from the axis: usually, and beside the service area.
HALF_MEDIAN_M, SERVICE_M = 4.0, 58.0
#: Stations between which the carriageways diverge, and between which they converge.
PART_M, APART_M, CLOSE_M, TOGETHER_M = 1700.0, 2200.0, 2700.0, 3200.0
FAST, DERESTRICTED = 33.33, 36.11


def _half_gap(station_m: Points) -> Points:
    """Return the distance of each carriageway from the axis; it grows and shrinks along cosines."""
    growth = np.clip((station_m - PART_M) / (APART_M - PART_M), 0.0, 1.0)
    shrinkage = np.clip((station_m - CLOSE_M) / (TOGETHER_M - CLOSE_M), 0.0, 1.0)
    return np.asarray(
        HALF_MEDIAN_M + (SERVICE_M - HALF_MEDIAN_M) * (np.cos(np.pi * shrinkage) - np.cos(np.pi * growth)) / 2
    )


def _carriageway(name: str, sections: tuple[Section, ...]) -> Carriageway:
    """Return the carriageway "E" (eastbound) or "W"; the sections are given by their stations along the axis."""
    is_east = name == "E"
    stations = np.linspace(0.0, AXIS.length_m, 90)
    stations = stations if is_east else stations[::-1]
    points = AXIS.at(stations, (-1.0 if is_east else 1.0) * _half_gap(stations))
    curve = Curve(points)
    sign = 1.0 if is_east else -1.0
    starts = [float(np.interp(sign * s.start_m, sign * stations, curve.stations_m)) for s in sections]
    laid = (Section(d, s.left, s.right, s.speed_mps) for d, s in zip(starts, sections, strict=True))
    return Carriageway(name, curve, tuple(laid))


EASTBOUND = _carriageway(
    "E",
    (
        Section(0.0, right=1, speed_mps=DERESTRICTED),
        Section(180.0, speed_mps=DERESTRICTED),  # lane drop, 4 to 3
        Section(330.0, right=1),
        Section(680.0),  # 3: exit 1
        Section(1020.0, right=1),  # 4: entry 1, weave
        Section(1400.0),  # 5: exit 2
        Section(1750.0, right=1),  # 6: entry 2
        Section(1800.0, left=1, right=1),
        Section(1950.0, left=1),
        Section(2150.0),  # 9: service area exit
        Section(2750.0, left=1),  # 10: service area entry
        Section(2880.0, left=1, right=1),
        Section(2980.0, right=1),
        Section(3260.0),  # 13: exit 3
        Section(3600.0, right=1, speed_mps=DERESTRICTED),  # 14: entry 3
        Section(3800.0, speed_mps=DERESTRICTED),
    ),
)
WESTBOUND = _carriageway(
    "W",
    (
        Section(AXIS.length_m, speed_mps=DERESTRICTED),
        Section(3930.0, right=1),
        Section(3630.0),  # 2: exit 3
        Section(3290.0, right=1),  # 3: entry 3
        Section(3150.0, left=1, right=1),
        Section(3060.0, left=1),
        Section(2750.0),  # 6: service area exit
        Section(2150.0, left=1),  # 7: service area entry
        Section(1880.0),
        Section(1700.0, right=1),
        Section(1295.0),  # 10: exit 1
        Section(945.0, right=1, speed_mps=DERESTRICTED),  # 11: entry 1
        Section(700.0, speed_mps=DERESTRICTED),
    ),
)

PLACES: dict[str, tuple[float, float]] = {  # station along the axis, offset to its left
    "J1": (850, -75), "K1": (850, -190), "F1": (850, -330), "KW": (420, -185), "J2": (1570, -75),
    "K2": (1570, -195), "F2": (1570, -330), "J3": (3430, -75), "K3": (3430, -190), "KE": (3860, -200),
    "N1": (1120, 75), "M1": (1120, 190), "MW": (700, 200), "G1": (1120, 330), "N3": (3460, 75),
    "M3": (3460, 190), "ME": (3900, 200), "G3": (3460, 330),
    "S1": (2350, -20), "S2": (2350, 20), "S3": (2550, -20), "S4": (2550, 20),
}  # fmt: skip
SIGNALS = ("K1", "K2", "K3", "M1", "M3")
RIGHT_BEFORE_LEFT = ("S2", "S3")


def _link(name: str, course: tuple[str, ...]) -> Street:
    """Return a link road: two lanes from the ramps to the signals, one lane back and beyond the signals."""
    return Street(name, course, ahead=2, speed_mps=13.89, priority=4, changes={course[1]: (1, 1)})


STREETS = (
    Street(
        "Valley Road", ("KW", "K1", "K2", (2000, -250), (2600, -270), "K3", "KE"), speed_mps=16.67, priority=6
    ),
    Street("Hill Road", ("MW", "M1", (1700, 250), (2600, 240), "M3", "ME"), speed_mps=16.67, priority=6),
    _link("Mill Link", ("J1", "K1", "F1")),
    _link("Ford Link", ("J2", "K2", "F2")),
    _link("Vale Link", ("J3", "K3")),
    _link("Ridge Link", ("N1", "M1", "G1")),
    _link("Moor Link", ("N3", "M3", "G3")),
    Street("Services South", ("S1", "S3"), speed_mps=8.33, priority=3),
    Street("Services North", ("S4", "S2"), speed_mps=8.33, priority=3),
    Street("Services West", ("S1", "S2"), speed_mps=8.33, priority=3),
    Street("Services East", ("S3", "S4"), speed_mps=8.33, priority=3),
)


def _ramps() -> list[Ramp]:
    """Return all ramps; the headings in the table are relative to the axis."""
    east, west = EASTBOUND, WESTBOUND
    slant = np.radians(20.0)
    table = [
        ("Exit 1", east, 3, "J1", -slant, True, False), ("Entry 1", east, 4, "J1", slant, False, False),
        ("Exit 2", east, 5, "J2", -slant, True, False), ("Entry 2", east, 6, "J2", slant, False, False),
        ("Exit 3", east, 13, "J3", -slant, True, False), ("Entry 3", east, 14, "J3", slant, False, False),
        ("Exit 3", west, 2, "N3", np.pi - slant, True, False),
        ("Entry 3", west, 3, "N3", np.pi + slant, False, False),
        ("Exit 1", west, 10, "N1", np.pi - slant, True, False),
        ("Entry 1", west, 11, "N1", np.pi + slant, False, False),
        ("Services", east, 9, "S1", 0.0, True, True), ("Services", east, 10, "S3", 0.0, False, True),
        ("Services", west, 6, "S4", np.pi, True, True), ("Services", west, 7, "S2", np.pi, False, True),
    ]  # fmt: skip
    ramps = []
    for name, road, section, node, heading, leaves, left in table:
        axis = AXIS.heading_rad(PLACES[node][0])
        ramps.append(
            Ramp(name, road, section, node, float(heading) + axis, leaves, left, 1.625 if left else 0.0)
        )
    return ramps


def plan() -> Plan:
    """Lay out both carriageways, the ramps, the roads beside them and the service area."""
    layout = Plan("motorway")
    lay_carriageway(layout, EASTBOUND)
    lay_carriageway(layout, WESTBOUND)
    motorway_nodes = frozenset(layout.nodes)
    kinds = dict.fromkeys(SIGNALS, "traffic_light") | dict.fromkeys(RIGHT_BEFORE_LEFT, "right_before_left")
    for name, (station, offset) in PLACES.items():
        x, y = AXIS.at(station, offset)[0]
        layout.add_node(Node(name, (float(x), float(y)), kinds.get(name, "priority")))
    for street in STREETS:
        lay(layout, street)
    lay_ramps(layout, _ramps())
    connect(layout, skip=motorway_nodes)
    return layout
