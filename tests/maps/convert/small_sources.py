"""The same small road in the formats of other maps: lanes "1" and "2" side by side, eastwards, followed by "3".

Lane 1 runs from (0, 0) to (50, 0) and lane 2 from (0, 3.5) to (50, 3.5), lane 1 on the right of it behind a dashed
line; lane 3 is a connector that turns left from the end of 2, and 4 follows it.
"""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyproj
import shapely
from source_writers import write_geopackage

HALF_M = 1.75
UTM_M = (456_100.0, 5_428_200.0)  # position of the road in zone 32, in Karlsruhe
NAMES = {
    "argoverse2": "log_map_archive_small.json",
    "commonroad": "TST_Small-1_1_T-1.xml.gz",
    "lanelet2": "small.osm",
    "nuplan": "map.gpkg",
}
Points = list[tuple[float, float]]


def sides(centre: list[tuple[float, float, float]]) -> tuple[Points, Points]:
    """Return the left and right boundary of poses on a centre line."""
    left = [(x - HALF_M * math.sin(a), y + HALF_M * math.cos(a)) for x, y, a in centre]
    return left, [(x + HALF_M * math.sin(a), y - HALF_M * math.cos(a)) for x, y, a in centre]


BEND = [
    (50.0 + 10.0 * math.sin(a), 13.5 - 10.0 * math.cos(a), a) for a in (k * math.pi / 16.0 for k in range(9))
]
LANES: dict[str, tuple[list[tuple[float, float, float]], list[str], bool]] = {
    "1": ([(0.0, 0.0, 0.0), (50.0, 0.0, 0.0)], [], False),
    "2": ([(0.0, 3.5, 0.0), (50.0, 3.5, 0.0)], ["3"], False),
    "3": (BEND, ["4"], True),
    "4": ([(60.0, 13.5, 0.5 * math.pi), (60.0, 60.0, 0.5 * math.pi)], [], False),
}


def argoverse2() -> dict[str, Any]:
    """Return the road as an Argoverse 2 map."""
    segments = {}
    for name, (centre, after, inside) in LANES.items():
        left, right = sides(centre)
        segments[name] = {
            "id": int(name),
            "is_intersection": inside,
            "lane_type": "VEHICLE",
            "left_lane_boundary": [{"x": x, "y": y, "z": 0.0} for x, y in left],
            "right_lane_boundary": [{"x": x, "y": y, "z": 0.0} for x, y in right],
            "left_lane_mark_type": "DASHED_WHITE" if name == "1" else "NONE",
            "right_lane_mark_type": "DASHED_WHITE" if name == "2" else "NONE",
            "left_neighbor_id": 2 if name == "1" else None,
            "right_neighbor_id": 1 if name == "2" else None,
            "successors": [int(other) for other in after],
            "predecessors": [int(other) for other in LANES if name in LANES[other][1]],
        }
    ring = [(0.0, -2.0), (62.0, -2.0), (62.0, 60.0), (0.0, 60.0)]
    area = {"id": 9, "area_boundary": [{"x": x, "y": y, "z": 0.0} for x, y in ring]}
    edges = [[{"x": x, "y": y, "z": 0.0} for y in (-2.0, 6.0)] for x in (20.0, 23.0)]
    crossing = {"id": 8, "edge1": edges[0], "edge2": edges[1]}
    return {
        "lane_segments": segments,
        "drivable_areas": {"9": area},
        "pedestrian_crossings": {"8": crossing},
    }


def commonroad() -> str:
    """Return the road as a CommonRoad scenario with a limit of 10 m/s on lane 1, a stop sign and a light on 2."""
    rows = []
    for name, (centre, after, _) in LANES.items():
        left, right = sides(centre)
        links = "".join(f'<successor ref="{other}"/>' for other in after)
        links += "".join(f'<predecessor ref="{other}"/>' for other in LANES if name in LANES[other][1])
        beside = {
            "1": '<adjacentLeft ref="2" drivingDir="same"/>',
            "2": '<adjacentRight ref="1" drivingDir="same"/>',
        }
        marks = ("dashed" if name == "1" else "solid", "dashed" if name == "2" else "solid")
        signs = {
            "1": '<trafficSignRef ref="20"/>',
            "2": '<trafficSignRef ref="21"/><trafficLightRef ref="30"/>',
        }
        rows.append(
            f'<lanelet id="{name}">{_bound("left", left, marks[0])}{_bound("right", right, marks[1])}{links}'
            f"{beside.get(name, '')}<laneletType>urban</laneletType>{signs.get(name, '')}</lanelet>"
        )
    signs = '<trafficSign id="20"><trafficSignElement><trafficSignID>274</trafficSignID>'
    signs += "<additionalValue>10</additionalValue></trafficSignElement></trafficSign>"
    signs += (
        '<trafficSign id="21"><trafficSignElement><trafficSignID>206</trafficSignID></trafficSignElement>'
    )
    signs += '</trafficSign><trafficLight id="30"/>'
    inside = '<intersection id="40"><incoming id="41"><incomingLanelet ref="2"/><successorsLeft ref="3"/>'
    head = '<commonRoad timeStepSize="0.1" commonRoadVersion="2020a" benchmarkID="TST_Small-1_1_T-1">'
    return f"{head}{''.join(rows)}{signs}{inside}</incoming></intersection>{_obstacle()}</commonRoad>"


def _bound(side: str, points: Points, mark: str) -> str:
    inner = "".join(f"<point><x>{x!r}</x><y>{y!r}</y></point>" for x, y in points)
    return f"<{side}Bound>{inner}<lineMarking>{mark}</lineMarking></{side}Bound>"


def _obstacle() -> str:
    """A car that drives along lane 1 at 5 m/s for 4 s."""
    states = []
    for step in range(41):
        place = f"<position><point><x>{5.0 + 0.5 * step!r}</x><y>0.0</y></point></position>"
        place += f"<orientation><exact>0.0</exact></orientation><time><exact>{step}</exact></time>"
        states.append(place + "<velocity><exact>5.0</exact></velocity>")
    first, *rest = states
    box = "<shape><rectangle><length>4.5</length><width>1.8</width></rectangle></shape>"
    path = "".join(f"<state>{state}</state>" for state in rest)
    return (
        f'<dynamicObstacle id="100"><type>car</type>{box}<initialState>{first}</initialState>'
        f"<trajectory>{path}</trajectory></dynamicObstacle>"
    )


def lanelet2(*, in_degrees: bool = False) -> str:
    """Return the road as a Lanelet2 map: nodes with local positions, one way for each side, lane 4 drawn backwards."""
    nodes: dict[tuple[float, float], int] = {}
    ways, relations = [], []
    for name, (centre, _, inside) in LANES.items():
        for side, points in zip(("left", "right"), sides(centre), strict=True):
            drawn = points[::-1] if (name, side) == ("4", "left") else points
            refs = [nodes.setdefault((round(x, 9), round(y, 9)), len(nodes) + 1) for x, y in drawn]
            number = 100 + 10 * int(name) + (side == "right")
            mark = "dashed" if (name, side) == ("1", "left") else "solid"
            inner = "".join(f'<nd ref="{ref}"/>' for ref in refs)
            ways.append(f'<way id="{number}">{inner}{_tags(type="line_thin", subtype=mark)}</way>')
        left, right = 100 + 10 * int(name), 101 + 10 * int(name)
        right = 110 if name == "2" else right  # lane 1's left line
        tags = _tags(type="lanelet", subtype="road", location="urban", one_way="yes", speed_limit="36 km/h")
        tags += _tags(turn_direction="left") if inside else ""
        rule = '<member type="relation" ref="900" role="regulatory_element"/>' if name == "2" else ""
        relations.append(
            f'<relation id="{name}"><member type="way" ref="{left}" role="left"/>'
            f'<member type="way" ref="{right}" role="right"/>{rule}{tags}</relation>'
        )
    light = _tags(type="regulatory_element", subtype="traffic_light")
    relations.append(f'<relation id="900"><member type="way" ref="130" role="refers"/>{light}</relation>')
    back = pyproj.Transformer.from_crs("EPSG:32632", "EPSG:4326", always_xy=True)
    places = []
    for (x, y), number in nodes.items():
        lon, lat = back.transform(UTM_M[0] + x, UTM_M[1] + y)
        tags = "" if in_degrees else _tags(local_x=str(x), local_y=str(y))
        places.append(f'<node id="{number}" lat="{lat!r}" lon="{lon!r}">{tags}</node>')
    return f'<osm version="0.6">{"".join(places)}{"".join(ways)}{"".join(relations)}</osm>'


def _tags(**values: str) -> str:
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in values.items())


def nuplan(path: Path, crosswalks: Sequence[shapely.Polygon] = ()) -> None:
    """Write the road as a nuPlan map whose projected system is UTM 11 N, about (500000, 4000000)."""
    lines, polygons, connectors, areas = [], [], [], []
    for name, (centre, _, inside) in LANES.items():
        left, right = sides(centre)
        ring = shapely.Polygon([*left, *right[::-1]])
        line = shapely.LineString([p[:2] for p in centre])
        lines.append(
            {
                "lane_fid": None if inside else name,
                "lane_connector_fid": name if inside else None,
                "geom": line,
            }
        )
        areas.append({"geom": ring})
        if inside:
            ends = {"exit_lane_fid": "2", "entry_lane_fid": "4"}
            connectors.append({"fid": int(name), **ends, "speed_limit_mps": 6.7, "geom": line})
        else:
            polygons.append({"lane_fid": name, "speed_limit_mps": 13.4, "geom": ring})
    layers = {"baseline_paths": lines, "lanes_polygons": polygons, "lane_connectors": connectors}
    if crosswalks:
        layers["crosswalks"] = [{"geom": area} for area in crosswalks]
    write_geopackage(path, {**layers, "generic_drivable_areas": areas}, "EPSG:32611")


def write(kind: str, folder: Path) -> Path:
    """Write the road in the format *kind* and return its path."""
    path = folder / NAMES[kind]
    if kind == "argoverse2":
        path.write_text(json.dumps(argoverse2()), encoding="utf-8")
    elif kind == "commonroad":
        path.write_bytes(gzip.compress(commonroad().encode(), mtime=0))
    elif kind == "lanelet2":
        path.write_text(lanelet2(), encoding="utf-8")
    elif kind == "nuplan":
        nuplan(path)
    return path
