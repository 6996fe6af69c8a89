"""Every invariant of a conversion, on small random maps."""

from __future__ import annotations

import itertools
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
import sumolib
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from small_maps import WIDTH_M, MapBuilder, Pose, step

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert import ConversionResult, convert_map
from advdiff_sumo.maps.convert.sources.arcline import sample_path
from advdiff_sumo.maps.convert.written_net import WrittenNet, read_net
from tests.example_counts import examples

MEDIAN_M, LARGEST_M = 0.02, 0.20
STEP_M = 0.5
LAYERS = (
    "stop_line",
    "ped_crossing",
    "walkway",
    "carpark_area",
    "lane_divider",
    "traffic_light",
    "road_segment",
)
SHAPES = ("LSL", "RSR", "LSR", "RSL")


@dataclass(frozen=True)
class Road:
    """One carriageway through a crossing: its lanes side by side, before and after.

    ``bend`` is a Dubins shape with its lengths in m and radius; ``leads`` and ``tails`` say how much later each lane
    begins and how much sooner it ends at the rim.
    """

    lanes: int
    yaw: float
    straight_m: float
    shape: str
    lengths: tuple[float, float, float]
    radius: float
    leads: tuple[float, ...]
    tails: tuple[float, ...]


@dataclass(frozen=True)
class Town:
    """Roads that cross in one place, some layers missing, on either side of the road."""

    roads: tuple[Road, ...]
    turns: bool
    lefthand: bool
    missing: frozenset[str]
    crossing: bool


@st.composite
def towns(draw: st.DrawFn) -> Town:
    """Draw a town of one to three roads; roads that cross do so at 50° or more."""
    count = draw(st.integers(1, 3))
    first = draw(st.floats(-3.0, 3.0))
    gap = math.pi / 3.0 if count == 3 else draw(st.floats(0.9, math.pi - 0.9))
    roads = tuple(draw(_roads(first + gap * number, 4 if count == 1 else 3)) for number in range(count))
    missing = draw(st.frozensets(st.sampled_from(LAYERS), max_size=4))
    return Town(roads, draw(st.booleans()), draw(st.booleans()), missing, draw(st.booleans()))


@st.composite
def _roads(draw: st.DrawFn, yaw: float, most: int) -> Road:
    lanes = draw(st.integers(1, most))
    metres = st.floats(0.0, 25.0)
    uneven = st.lists(st.sampled_from([0.0, 0.0, 3.0, 14.0, 30.0]), min_size=lanes, max_size=lanes).map(tuple)
    lengths = draw(st.tuples(metres, metres, metres).filter(lambda v: sum(v) > 5.0))
    shape, radius = draw(st.sampled_from(SHAPES)), draw(st.floats(40.0, 400.0))
    straight = draw(st.floats(50.0, 90.0))
    return Road(lanes, yaw, straight, shape, lengths, radius, draw(uneven), draw(uneven))


def build(town: Town) -> MapBuilder:
    """Return the map of a town whose roads cross around (500, 500)."""
    builder = MapBuilder()
    for number, road in enumerate(town.roads):
        for lane in range(road.lanes):
            _lane(builder, number, road, lane, half=20.0)
    if town.turns and len(town.roads) > 1:
        _turn(builder, town)
    if town.crossing:
        builder.area("ped_crossing", [(490.0, 470.0), (510.0, 470.0), (510.0, 473.0), (490.0, 473.0)])
    return builder


def _lane(builder: MapBuilder, number: int, road: Road, lane: int, half: float) -> None:
    """Add a lane into the crossing, a connector across it and a bent lane out; lane 0 is the rightmost."""
    name = f"{number}.{lane}"
    aside = (lane - 0.5 * (road.lanes - 1)) * WIDTH_M
    along, left = (math.cos(road.yaw), math.sin(road.yaw)), (-math.sin(road.yaw), math.cos(road.yaw))
    at = [500.0 + aside * left[i] - (half + road.straight_m - road.leads[lane]) * along[i] for i in (0, 1)]
    end = builder.straight(f"in{name}", (at[0], at[1], road.yaw), road.straight_m - road.leads[lane])
    end = builder.straight(f"x{name}", end, 2.0 * half, connector=True)
    # parallel arcs: a lane to the left has a smaller radius in a left bend
    pieces = []
    for letter, length in zip(road.shape, road.lengths, strict=True):
        turned = {"L": -1.0, "S": 0.0, "R": 1.0}[letter]
        pieces.append((letter, length * (1.0 + turned * aside / road.radius), road.radius + turned * aside))
    _bent(builder, f"out{name}", end, pieces, 20.0 + max(road.tails) - road.tails[lane])
    builder.link(f"in{name}", f"x{name}", f"out{name}")


def _bent(
    builder: MapBuilder, token: str, start: Pose, arcs: list[tuple[str, float, float]], last_m: float
) -> None:
    """Add a lane of several Dubins pieces (each arc has its own radius) and a straight end."""
    pose, points, pieces = start, [start], []
    for letter, length, radius in [*arcs, ("S", last_m, 999.999)]:
        if length <= 0.0:
            continue
        begin = pose
        for _ in range(8):
            pose = step(pose, letter, length / 8, radius)
            points.append(pose)
        shape, lengths = ("LSR", [0.0, length, 0.0]) if letter == "S" else (letter + "SR", [length, 0.0, 0.0])
        piece = {"start_pose": list(begin), "end_pose": list(pose), "shape": shape, "radius": radius}
        pieces.append({**piece, "segment_length": lengths})
    builder.data["arcline_path_3"][token] = pieces
    half = 0.5 * WIDTH_M
    sides = [[(x - s * math.sin(a), y + s * math.cos(a)) for x, y, a in points] for s in (half, -half)]
    builder.data["lane"].append({"token": token, "polygon_token": builder.polygon(sides[0] + sides[1][::-1])})
    builder.data["connectivity"][token] = {"incoming": [], "outgoing": []}


def _turn(builder: MapBuilder, town: Town) -> None:
    """Add a turn from the outer lane of road 0 to the outer lane of road 1 by a chain of two straight chords."""
    lanes = [0, 0] if not town.lefthand else [road.lanes - 1 for road in town.roads[:2]]
    a = builder.data["arcline_path_3"][f"in0.{lanes[0]}"][-1]["end_pose"]
    b = builder.data["arcline_path_3"][f"out1.{lanes[1]}"][0]["start_pose"]
    reach = math.dist(a[:2], b[:2]) / 3.0
    corners = [a[:2], [a[i] + reach * (math.cos, math.sin)[i](a[2]) for i in (0, 1)]]
    corners += [[b[i] - reach * (math.cos, math.sin)[i](b[2]) for i in (0, 1)], b[:2]]
    pieces = []
    for p, q in itertools.pairwise(corners):
        yaw, length = math.atan2(q[1] - p[1], q[0] - p[0]), math.dist(p, q)
        piece = {"start_pose": [*p, yaw], "end_pose": [*q, yaw], "shape": "LSR", "radius": 999.999}
        pieces.append({**piece, "segment_length": [0.0, length, 0.0]})
    builder.data["arcline_path_3"]["turn"] = pieces
    builder.data["lane_connector"].append({"token": "turn"})
    builder.data["connectivity"]["turn"] = {"incoming": [], "outgoing": []}
    builder.link(f"in0.{lanes[0]}", "turn", f"out1.{lanes[1]}")


def check_geometry(data: dict[str, object], net: WrittenNet) -> None:
    """No lane or connector is lost: lines of the net cover each of them and run nowhere else.

    The source is integrated again here, and no book-keeping of the converter is used.
    """
    paths = data["arcline_path_3"]
    assert isinstance(paths, dict)
    drawn = [shapely.LineString(line) for line, _ in (*net.lanes.values(), *net.connections.values())]
    source = [shapely.LineString(sample_path(pieces)) for pieces in paths.values()]
    for lines, others in ((source, drawn), (drawn, source)):
        whole = shapely.union_all(others)
        away = [np.asarray(shapely.distance(_places(line), whole)) for line in lines]
        assert max(float(part.max()) for part in away) <= LARGEST_M
        assert float(np.median(np.concatenate(away))) <= MEDIAN_M


def _places(line: shapely.LineString) -> FloatArray:
    return np.asarray(
        shapely.line_interpolate_point(line, np.linspace(0.0, line.length, 1 + int(line.length / STEP_M)))
    )


def check_connectivity(data: dict[str, object], result: ConversionResult, net: WrittenNet) -> None:
    """The net connects exactly the lanes that the map connects.

    Each edge lane is traced back to its source lane by geometry (the one nearest to its middle with its yaw), so that
    a path in the net becomes a list of source lanes.
    """
    connectivity, paths = data["connectivity"], data["arcline_path_3"]
    assert isinstance(connectivity, dict)
    assert isinstance(paths, dict)
    roads = [token for token in paths if token[0] in "io"]
    lines = {token: shapely.LineString(sample_path(paths[token])) for token in roads}
    of = {key: _nearest(line, lines) for key, (line, _) in net.lanes.items()}
    assert set(of.values()) == set(roads)
    found = {(of[a, i], of[b, j]) for a, i, b, j in net.connections} - {(token, token) for token in roads}
    given_links = {
        (a, b) for a in roads for x in connectivity[a]["outgoing"] for b in connectivity[x]["outgoing"]
    }
    assert found == given_links
    assert len(result.duplicates) == 0


def _nearest(line: FloatArray, lines: dict[str, shapely.LineString]) -> str:
    middle = shapely.LineString(line).interpolate(0.5, normalized=True)
    return min(lines, key=lambda token: float(lines[token].distance(middle)))


def check_lane_order(net: WrittenNet, lefthand: bool) -> None:
    """Lane 0 of each edge is outermost: rightmost where traffic keeps right, leftmost where it keeps left."""
    for (edge, index), (line, _) in net.lanes.items():
        if (edge, index + 1) in net.lanes:
            inner = net.lanes[edge, index + 1][0]
            along = line[-1] - line[0]
            toward = (
                inner.mean(axis=0) - line.mean(axis=0) if len(line) == len(inner) == 2 else inner[0] - line[0]
            )
            yaw = line[1] - line[0]
            side = float(yaw[0] * toward[1] - yaw[1] * toward[0])
            assert (side < 0.0) == lefthand
            assert float(along @ (inner[-1] - inner[0])) > 0.0


def check_side_car(data: dict[str, object], result: ConversionResult, town: Town) -> None:
    """Polygons are valid, and the drivable area with its holes covers every lane's area."""
    rows = list(sumolib.xml.parse(str(result.sidecar), "poly"))
    shapes = [
        (row.type, shapely.Polygon([tuple(map(float, p.split(","))) for p in row.shape.split()]))
        for row in rows
    ]
    assert all(shape.is_valid for _, shape in shapes)
    area = shapely.union_all([shape.buffer(1e-3) for kind, shape in shapes if kind == "drivable_area"])
    holes = shapely.union_all([shape for kind, shape in shapes if kind == "drivable_area_hole"])
    polygons = [track.lane.polygon for track in result.tracks if track.lane.polygon is not None]
    assert shapely.union_all(polygons).difference(area.difference(holes)).area <= 0.5
    crossings = sum(kind == "ped_crossing" for kind, _ in shapes)
    assert crossings == (town.crossing and "ped_crossing" not in town.missing)


@settings(max_examples=examples(12, 30), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(towns())
def test_any_town_keeps_every_invariant(town: Town) -> None:
    event(f"{len(town.roads)} roads, {'left' if town.lefthand else 'right'}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        builder = build(town)
        for layer in sorted(town.missing):
            del builder.data[layer]
        path = builder.write(folder / "town.json")
        result = convert_map(path, folder / "town.net.xml", lefthand=town.lefthand)
        net = read_net(result.net)
        check_geometry(builder.data, net)
        check_connectivity(builder.data, result, net)
        check_lane_order(net, town.lefthand)
        check_side_car(builder.data, result, town)
