"""Crossings of Argoverse 2, CommonRoad and Lanelet2 maps: kept over the ways of a junction, and told where malformed.

The small road of ``small_sources`` turns left from (50, 3.5) to (60, 13.5) about (50, 13.5), where a crossing 2 m wide
lies across the middle of the bend: from 7 m to 14 m from that centre, at 45° below the x axis.
"""

from __future__ import annotations

import gzip
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
import shapely
from small_sources import argoverse2, commonroad, lanelet2, nuplan

from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.sources.read_map import read_map

Points = list[tuple[float, float]]


def side(offset_m: float, mid_block: bool = False) -> Points:
    """Return one long side of the crossing, *offset_m* from its middle: over the bend, or over lanes 1 and 2."""
    if mid_block:
        return [(25.0 + offset_m, -2.0), (25.0 + offset_m, 6.0)]
    c, s = math.cos(-0.25 * math.pi), math.sin(-0.25 * math.pi)
    return [(50.0 + r * c - offset_m * s, 13.5 + r * s + offset_m * c) for r in (7.0, 14.0)]


def as_argoverse2(folder: Path, broken: bool, mid_block: bool = False) -> Path:
    data = argoverse2()
    edges = [[{"x": x, "y": y, "z": 0.0} for x, y in side(offset, mid_block)] for offset in (-1.0, 1.0)]
    data["pedestrian_crossings"] = {
        "8": {"id": 8, "edge1": edges[0]} | ({} if broken else {"edge2": edges[1]})
    }
    path = folder / "log_map_archive_small.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


def as_commonroad(folder: Path, broken: bool, mid_block: bool = False) -> Path:
    bounds = ""
    for name, offset in (("left", 1.0), ("right", -1.0)):
        points = "".join(
            f"<point><x>{x!r}</x><y>{'far' if broken else y!r}</y></point>"
            for x, y in side(offset, mid_block)
        )
        bounds += f"<{name}Bound>{points}</{name}Bound>"
    row = f'<lanelet id="80">{bounds}<laneletType>crosswalk</laneletType></lanelet><trafficSign id'
    path = folder / "TST_Small-1_1_T-1.xml.gz"
    path.write_bytes(gzip.compress(commonroad().replace("<trafficSign id", row, 1).encode()))
    return path


def as_lanelet2(folder: Path, broken: bool, mid_block: bool = False) -> Path:
    nodes, ways = "", ""
    for number, offset in ((701, 1.0), (702, -1.0)):
        for k, (x, y) in enumerate(side(offset, mid_block)):
            tags = "".join(
                f"<tag k={quoteattr(key)} v='{v!r}'/>" for key, v in (("local_x", x), ("local_y", y))
            )
            nodes += f'<node id="{10 * number + k}" lat="49" lon="8.4">{tags}</node>'
        ways += f'<way id="{number}"><nd ref="{10 * number}"/><nd ref="{10 * number + 1}"/></way>'
    left = 999 if broken else 701
    relation = f'<relation id="80"><member type="way" ref="{left}" role="left"/>'
    relation += '<member type="way" ref="702" role="right"/><tag k="type" v="lanelet"/><tag k="subtype" v="crosswalk"/>'
    text = lanelet2().replace("<way", nodes + "<way", 1).replace("<relation", ways + "<relation", 1)
    path = folder / "small.osm"
    path.write_text(re.sub("</osm>$", f"{relation}</relation></osm>", text), encoding="utf-8")
    return path


def as_nuplan(folder: Path, broken: bool, mid_block: bool = False) -> Path:
    """Write the road as nuPlan has it; its shapes cannot be broken this way."""
    assert not broken
    path = folder / "map.gpkg"
    nuplan(path, [shapely.Polygon([*side(1.0, mid_block), *side(-1.0, mid_block)[::-1]])])
    return path


@pytest.mark.parametrize("write", [as_argoverse2, as_commonroad, as_lanelet2, as_nuplan])
def test_a_crossing_in_mid_block_parts_the_lanes(
    write: Callable[[Path, bool, bool], Path], tmp_path: Path
) -> None:
    """2 m wide at x = 25, with 0.5 m on both sides; of the four lanes and two links nothing is lost."""
    result = convert_source(read_map(write(tmp_path, False, True)), tmp_path / "n.net.xml")
    figures = measure(result).as_dict()
    assert (figures["crossings"]["given"], figures["crossings"]["kept"]) == (1, 1)
    assert figures["lanes"]["held"] == figures["lanes"]["given"] == 4
    assert figures["connections"]["kept"] == figures["connections"]["given"] == 2
    parts = [lane.source.split(":")[1:] for edge in result.plan.edges for lane in edge.lanes]
    assert parts.count(["0.000", "23.500"]) == parts.count(["26.500", "50.000"]) == 2


@pytest.mark.parametrize("write", [as_argoverse2, as_commonroad, as_lanelet2])
def test_a_crossing_over_the_bend_is_kept(write: Callable[[Path, bool], Path], tmp_path: Path) -> None:
    source = read_map(write(tmp_path, False))
    paths = convert_source(source, tmp_path / "n.net.xml").foot_paths
    assert paths is not None
    assert (paths.given, paths.kept, paths.left_out) == (1, 1, {})
    assert not [text for text in source.warnings if "80" in text or "'8'" in text]


@pytest.mark.parametrize(
    ("write", "sentence"),
    [
        (as_argoverse2, "the area '8' (edge1) is unusable and left out"),
        (as_commonroad, "crosswalk '80' is left out: a coordinate of a boundary is no number"),
        (as_lanelet2, "lanelet '80' for people on foot is left out: "),
    ],
)
def test_a_malformed_crossing_is_one_sentence(
    write: Callable[[Path, bool], Path], sentence: str, tmp_path: Path
) -> None:
    path = write(tmp_path, True)
    source = read_map(path)
    assert source.crossings == ()
    (told,) = [text for text in source.warnings if "left out" in text]
    assert told.startswith(f"{path.name}: {sentence}")
