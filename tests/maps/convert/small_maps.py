"""Maps small enough to work out by hand, in the format of the map expansion."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from typing import Any

WIDTH_M = 3.5
Pose = tuple[float, float, float]


class MapBuilder:
    """Collects lanes and writes them as a map expansion."""

    def __init__(self) -> None:
        self.data: dict[str, Any] = {
            "version": "1.3",
            "canvas_edge": [500.0, 500.0],
            "arcline_path_3": {},
            "connectivity": {},
        }
        tables = (
            "polygon",
            "line",
            "node",
            "drivable_area",
            "road_segment",
            "lane",
            "lane_connector",
            "stop_line",
        )
        tables += ("ped_crossing", "walkway", "carpark_area", "lane_divider", "road_divider", "traffic_light")
        self.data.update({name: [] for name in tables})

    def node(self, x: float, y: float) -> str:
        """Add a node and return its token."""
        token = f"node{len(self.data['node'])}"
        self.data["node"].append({"token": token, "x": x, "y": y})
        return token

    def polygon(self, points: list[tuple[float, float]]) -> str:
        """Add a polygon and return its token."""
        token = f"polygon{len(self.data['polygon'])}"
        nodes = [self.node(x, y) for x, y in points]
        self.data["polygon"].append({"token": token, "exterior_node_tokens": nodes, "holes": []})
        return token

    def lane(
        self,
        token: str,
        start: Pose,
        shape: str,
        lengths: list[float],
        radius: float = 999.999,
        *,
        connector: bool = False,
    ) -> Pose:
        """Add a lane of one Dubins piece and return the pose of its end."""
        end, points = start, [start]
        for letter, length in zip(shape, lengths, strict=True):
            for _ in range(8 if length else 0):
                end = step(end, letter, length / 8, radius)
                points.append(end)
        piece = {"start_pose": list(start), "end_pose": list(end), "shape": shape, "radius": radius}
        self.data["arcline_path_3"][token] = [{**piece, "segment_length": lengths}]
        half = 0.5 * WIDTH_M
        left = [(x - half * math.sin(a), y + half * math.cos(a)) for x, y, a in points]
        right = [(x + half * math.sin(a), y - half * math.cos(a)) for x, y, a in points]
        row = {"token": token, "polygon_token": self.polygon(left + right[::-1])}
        self.data["lane_connector" if connector else "lane"].append(row)
        self.data["connectivity"][token] = {"incoming": [], "outgoing": []}
        return end

    def straight(self, token: str, start: Pose, length: float, *, connector: bool = False) -> Pose:
        """Add a straight lane and return the pose of its end."""
        return self.lane(token, start, "LSR", [0.0, length, 0.0], connector=connector)

    def link(self, *tokens: str) -> None:
        """Link each of *tokens* to the next one."""
        for a, b in itertools.pairwise(tokens):
            self.data["connectivity"][a]["outgoing"].append(b)
            self.data["connectivity"][b]["incoming"].append(a)

    def dashed(self, points: list[tuple[float, float]]) -> None:
        """Add a dashed lane divider."""
        rows = [{"node_token": self.node(x, y), "segment_type": "SINGLE_DASHED_WHITE"} for x, y in points]
        number = len(self.data["lane_divider"])
        self.data["lane_divider"].append({"token": f"divider{number}", "lane_divider_segments": rows})

    def area(self, layer: str, points: list[tuple[float, float]]) -> None:
        """Add a crossing, walkway or parking area."""
        row = {"token": f"{layer}{len(self.data[layer])}", "polygon_token": self.polygon(points)}
        self.data[layer].append(row)

    def write(self, path: Path) -> Path:
        """Write the map and return its path; lanes together are the drivable area."""
        rows = [row for layer in ("lane", "lane_connector") for row in self.data[layer]]
        tokens = [row["polygon_token"] for row in rows if "polygon_token" in row]
        self.data["drivable_area"] = [{"token": "drivable", "polygon_tokens": tokens}]
        path.write_text(json.dumps(self.data), encoding="utf-8")
        return path


def step(pose: Pose, letter: str, length: float, radius: float) -> Pose:
    """Return the pose after *length* m along an arc (L, R) or a straight line (S)."""
    x, y, yaw = pose
    turn = {"L": 1.0, "S": 0.0, "R": -1.0}[letter] * length / radius
    if turn == 0.0:
        return x + length * math.cos(yaw), y + length * math.sin(yaw), yaw
    signed = length / turn
    return (
        x + signed * (math.sin(yaw + turn) - math.sin(yaw)),
        y - signed * (math.cos(yaw + turn) - math.cos(yaw)),
        yaw + turn,
    )


def two_lane_road(lead_m: float = 0.0, second_m: float = 80.0) -> MapBuilder:
    """Return a road eastwards: lane "a" north of lane "b", with connectors to "c" and "d".

    Lane "b" begins *lead_m* after "a", which is *second_m* long.
    """
    road = MapBuilder()
    end = road.straight("a", (100.0, 103.5, 0.0), second_m)
    road.straight("b", (100.0 + lead_m, 100.0, 0.0), second_m - lead_m)
    x = end[0]
    road.straight("a-c", end, 10.0, connector=True)
    road.straight("b-d", (x, 100.0, 0.0), 10.0, connector=True)
    road.straight("c", (x + 10.0, 103.5, 0.0), 60.0)
    road.straight("d", (x + 10.0, 100.0, 0.0), 60.0)
    road.link("a", "a-c", "c")
    road.link("b", "b-d", "d")
    road.dashed([(100.0 + lead_m, 101.75), (x, 101.75)])
    road.dashed([(x + 10.0, 101.75), (x + 70.0, 101.75)])
    return road


def crossroads() -> MapBuilder:
    """Return a crossing of a road eastwards and one northwards, with a left turn from east to north."""
    cross = MapBuilder()
    west = cross.straight("west", (40.0, 100.0, 0.0), 50.0)
    south = cross.straight("south", (100.0, 40.0, 0.5 * math.pi), 50.0)
    cross.straight("west-east", west, 20.0, connector=True)
    cross.straight("south-north", south, 20.0, connector=True)
    cross.lane("west-north", west, "LSR", [0.5 * math.pi * 10.0, 0.0, 0.0], 10.0, connector=True)
    cross.straight("east", (110.0, 100.0, 0.0), 50.0)
    cross.straight("north", (100.0, 110.0, 0.5 * math.pi), 50.0)
    cross.link("west", "west-east", "east")
    cross.link("south", "south-north", "north")
    cross.link("west", "west-north", "north")
    return cross
