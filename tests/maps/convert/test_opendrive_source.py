"""Reading OpenDRIVE: curves, lanes and links computed by hand."""

from __future__ import annotations

import math
import subprocess
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import pytest
import sumo  # type: ignore[import-untyped]
from defusedxml import ElementTree
from scipy.special import fresnel

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import MapError
from advdiff_sumo.export.net_opendrive import write_net_opendrive
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.sources.opendrive_curves import ReferenceLine, cubics, value_at
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.maps.convert.sources.source_map import LaneUse, SourceMap


def line(shape: str, length: float, hdg: float = 0.0) -> ReferenceLine:
    """Return a reference line of one piece that begins at (10, 20)."""
    text = f'<geometry s="0" x="10" y="20" hdg="{hdg}" length="{length}">{shape}</geometry>'
    return ReferenceLine([element(text)])


def element(text: str) -> Element:
    """Return an element of XML."""
    parsed: Element = ElementTree.fromstring(text)
    return parsed


def ends(reference: ReferenceLine) -> tuple[FloatArray, float]:
    """Return the end of a line relative to its beginning, and its heading there."""
    xy, yaw = reference.at(np.linspace(0.0, reference.length_m, 50))
    return xy[-1] - [10.0, 20.0], float(yaw[-1])


def test_line_and_arc() -> None:
    place, yaw = ends(line("<line/>", 5.0, 0.5 * math.pi))
    assert place == pytest.approx([0.0, 5.0], abs=1e-9)
    place, yaw = ends(
        line('<arc curvature="0.1"/>', 5.0 * math.pi)
    )  # a quarter of a circle of 10 m to the left
    assert place == pytest.approx([10.0, 10.0], abs=1e-9)
    assert yaw == pytest.approx(0.5 * math.pi)


def test_spiral() -> None:
    """A clothoid from 0 to 0.1 1/m over 20 m: x and y are Fresnel integrals scaled by sqrt(pi L / k)."""
    place, yaw = ends(line('<spiral curvStart="0" curvEnd="0.1"/>', 20.0))
    scale = math.sqrt(math.pi * 20.0 / 0.1)
    sine, cosine = fresnel(20.0 / scale)
    assert place == pytest.approx([scale * cosine, scale * sine], abs=1e-9)
    assert yaw == pytest.approx(1.0)


def test_cubics() -> None:
    """The curve v = u² / 100 is 36.09 m long up to u = 30; p of the parametric one runs from 0 to 1."""
    arc = 0.5 * 30.0 * math.hypot(1.0, 0.6) + 25.0 * math.asinh(0.6)
    place, yaw = ends(line('<poly3 a="0" b="0" c="0.01" d="0"/>', arc))
    assert place == pytest.approx([30.0, 9.0], abs=1e-3)
    assert yaw == pytest.approx(math.atan(0.6), abs=1e-4)
    shape = '<paramPoly3 pRange="normalized" aU="0" bU="30" cU="0" dU="0" aV="0" bV="0" cV="9" dV="0"/>'
    place, yaw = ends(line(shape, arc))
    assert place == pytest.approx([30.0, 9.0])
    assert yaw == pytest.approx(math.atan(0.6))


def test_piecewise_widths() -> None:
    rows = [element('<width sOffset="5" a="3" b="0.1"/>'), element('<width sOffset="0" a="2"/>')]
    widths = value_at(cubics(rows, base_m=100.0), np.array([99.0, 100.0, 104.0, 105.0, 115.0]))
    assert widths.tolist() == [0.0, 2.0, 2.0, 3.0, 4.0]


def road(
    name: str, x: float, length: float, lanes: str, link: str = "", junction: str = "-1", more: str = ""
) -> str:
    """Return a road eastwards from (x, 0) with one section."""
    return (
        f'<road id="{name}" length="{length}" junction="{junction}" {more}><link>{link}</link>'
        '<type s="0" type="town"><speed max="36" unit="km/h"/></type>'
        f'<planView><geometry s="0" x="{x}" y="0" hdg="0" length="{length}"><line/></geometry></planView>'
        f'<lanes><laneOffset s="0" a="1"/><laneSection s="0">{lanes}</laneSection></lanes></road>'
    )


def lane(number: int, kind: str = "driving", link: str = "", mark: str = "solid", more: str = "") -> str:
    """Return a lane of 3 m."""
    row = f'<lane id="{number}" type="{kind}"><link>{link}</link><width sOffset="0" a="3" b="0"/>'
    return f'{row}<roadMark sOffset="0" type="{mark}"/>{more}</lane>'


def sections(left: str, right: str, centre: str = "solid") -> str:
    """Return the sides of a lane section."""
    middle = f'<center><lane id="0" type="none"><roadMark sOffset="0" type="{centre}"/></lane></center>'
    return f"<left>{left}</left>{middle}<right>{right}</right>"


def read(folder: Path, *roads: str) -> SourceMap:
    """Return the map of *roads*."""
    path = folder / "m.xodr"
    path.write_text(f"<OpenDRIVE><header/>{''.join(roads)}</OpenDRIVE>", encoding="utf-8")
    return read_map(path)


def test_lanes_of_both_directions(tmp_path: Path) -> None:
    """The reference line lies at y = 0 and the middle of the lanes, shifted by the offset, at y = 1."""
    speed = '<speed sOffset="0" max="5" unit="m/s"/>'
    right = lane(-1, mark="broken") + lane(-2, "bus") + lane(-3, "sidewalk")
    source = read(tmp_path, road("7", 0.0, 40.0, sections(lane(1, more=speed), right)))
    drawn = {row.token: row.centre_m.round(9).tolist() for row in source.lanes}
    assert drawn == {
        "7_0_1": [[40.0, 2.5], [0.0, 2.5]],
        "7_0_-1": [[0.0, -0.5], [40.0, -0.5]],
        "7_0_-2": [[0.0, -3.5], [40.0, -3.5]],
    }
    first, left, bus = (next(r for r in source.lanes if r.token == f"7_0_{n}") for n in (-1, 1, -2))
    assert first.right_dashed == bus.left_dashed != frozenset()
    assert (first.left_solid, left.left_solid, bus.right_solid) == (True, True, True)
    assert (first.speed_mps, left.speed_mps, bus.use) == (pytest.approx(10.0), 5.0, LaneUse.BUS)
    assert source.walkways[0].bounds == pytest.approx((0.0, -8.0, 40.0, -5.0))
    assert first.polygon is not None
    assert first.polygon.bounds == pytest.approx((0.0, -2.0, 40.0, 1.0))


def test_a_section_of_a_single_side_leaves_the_other_one_as_it_is(tmp_path: Path) -> None:
    """After 20 m, road 7 has a second lane on its right; its left lane is 40 m long; road 8 follows."""
    on, before = '<successor id="-1"/>', '<predecessor id="1"/>'
    right = lane(-1, mark="broken") + lane(-2)
    extra = f'</laneSection><laneSection s="20" singleSide="true"><right>{right}</right></laneSection>'
    rows = sections(lane(1), lane(-1, link=on))
    after = '<successor elementType="road" elementId="8" contactPoint="start"/>'
    back = '<predecessor elementType="road" elementId="7" contactPoint="end"/>'
    both = sections(lane(1, link=before), lane(-1, link='<predecessor id="-1"/>'))
    source = read(
        tmp_path,
        road("7", 0.0, 40.0, rows, after).replace("</laneSection>", extra),
        road("8", 40.0, 30.0, both, back),
    )
    drawn = {row.token: row.centre_m.round(9).tolist() for row in source.lanes if row.token[0] == "7"}
    assert drawn == {
        "7_0_1": [[40.0, 2.5], [0.0, 2.5]],
        "7_0_-1": [[0.0, -0.5], [20.0, -0.5]],
        "7_1_-1": [[20.0, -0.5], [40.0, -0.5]],
        "7_1_-2": [[20.0, -3.5], [40.0, -3.5]],
    }
    assert sorted(source.links) == [("7_0_-1", "7_1_-1"), ("7_1_-1", "8_0_-1"), ("8_0_1", "7_0_1")]
    assert [row.left_solid for row in source.lanes if row.token[0] == "7"] == [True, True, True, False]
    assert (source.warnings, source.left_out) == ((), ())


BROKEN, SOLID = '<roadMark sOffset="{}" type="broken"/>', '<roadMark sOffset="{}" type="solid"/>'
STATED = '<roadMark sOffset="0" type="{}" laneChange="{}"/>'
NONE = '<roadMark sOffset="0" type="none"/>'


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(
    ("marks", "out", "back"),
    [
        (BROKEN.format(0) + SOLID.format(20), True, True),
        (SOLID.format(0) + BROKEN.format(20), True, True),
        (NONE + SOLID.format(20), None, None),  # not solid everywhere
        (NONE + BROKEN.format(20), True, True),
        (NONE, None, None),
        (STATED.format("broken", "none"), False, False),
        (STATED.format("none", "none"), False, False),
        (STATED.format("solid", "both"), True, True),
        (STATED.format("solid broken", "increase"), False, True),
        (STATED.format("solid broken", "decrease"), True, False),
        (STATED.format("solid", "none") + BROKEN.format(20), True, True),
    ],
)
def test_markings_that_may_be_crossed(
    marks: str, out: bool | None, back: bool | None, side: int, tmp_path: Path
) -> None:
    """Lanes 1 and 2 of a *side*: whether a vehicle on lane 1 may change *out* to lane 2 on its right, and *back*.

    On the left, going out is towards higher numbers.
    """
    if side == 1 and "crease" in marks:
        out, back = back, out
    given = '<roadMark sOffset="0" type="solid"/>'
    inner = lane(side).replace(given, marks)
    rows = inner + lane(2 * side)
    source = read(tmp_path, road("7", 0.0, 40.0, sections(*(("", rows) if side < 0 else (rows, "")))))
    first, second = (next(r for r in source.lanes if r.token == f"7_0_{n * side}") for n in (1, 2))
    assert first.right_solid is (out is False)
    assert second.left_solid is (back is False)
    assert (first.right_dashed == second.left_dashed != frozenset()) is (back is True)


def test_where_traffic_keeps_left_lanes_run_the_other_way(tmp_path: Path) -> None:
    source = read(tmp_path, road("7", 0.0, 40.0, sections(lane(1), lane(-1)), more='rule="LHT"'))
    assert (source.keeps_left, source.warnings) == (True, ())
    starts = {row.token: row.centre_m[0].round(9).tolist() for row in source.lanes}
    assert starts == {"7_0_1": [0.0, 2.5], "7_0_-1": [40.0, -0.5]}


@pytest.mark.parametrize("lefthand", [False, True])
def test_what_is_written_of_a_net_is_read_back_on_the_same_side(tmp_path: Path, lefthand: bool) -> None:
    net, xodr = tmp_path / "grid.net.xml", tmp_path / "grid.xodr"
    words = ["--grid", "--grid.number=2", "--grid.length=100", "--default.lanenumber=2"]
    command = [str(Path(sumo.SUMO_HOME, "bin/netgenerate")), *words, f"--lefthand={lefthand}", f"-o={net}"]
    subprocess.run(command, check=True, capture_output=True)
    write_net_opendrive(RoadMap.read(net), xodr)
    source = read_map(xodr)
    assert source.keeps_left is lefthand
    again = RoadMap.read(convert_source(source, tmp_path / "again.net.xml").net)
    assert again.lefthand is lefthand
    given = convert_source(source, tmp_path / "other.net.xml", lefthand=not lefthand)
    assert RoadMap.read(given.net).lefthand is not lefthand


def test_links_of_roads_and_junctions(tmp_path: Path) -> None:
    """Road 1 leads via road 2 in junction 9 to road 3, followed by road 4; lanes on the left lead back."""
    to_junction = '<successor elementType="junction" elementId="9"/>'
    before = '<predecessor elementType="road" elementId="1" contactPoint="end"/>'
    after = '<successor elementType="road" elementId="3" contactPoint="start"/>'
    both = '<predecessor id="{0}"/><successor id="{0}"/>'
    on = '<predecessor elementType="junction" elementId="9"/>'
    on += '<successor elementType="road" elementId="4" contactPoint="start"/>'
    back = '<predecessor elementType="road" elementId="3" contactPoint="end"/>'
    source = read(
        tmp_path,
        road("1", 0.0, 40.0, sections(lane(1), lane(-1)), to_junction),
        road("2", 40.0, 10.0, sections("", lane(-1, link=both.format(-1))), before + after, "9"),
        road(
            "3",
            50.0,
            40.0,
            sections(lane(1, link='<successor id="1"/>'), lane(-1, link='<successor id="-1"/>')),
            on,
        ),
        road("4", 90.0, 40.0, sections(lane(1), lane(-1)), back),
        '<junction id="9"><connection id="0" incomingRoad="1" connectingRoad="2" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection></junction>',
    )
    assert sorted(source.links) == [
        ("1_0_-1", "2_0_-1"),
        ("2_0_-1", "3_0_-1"),
        ("3_0_-1", "4_0_-1"),
        ("4_0_1", "3_0_1"),
    ]
    assert [row.token for row in source.lanes if row.is_connector] == ["2_0_-1"]
    result = convert_source(source, tmp_path / "n.net.xml")
    assert len(result.plan.connections) == 3  # 2 lies inside a junction


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('length="40.0"><line/>', 'length="nan"><line/>', "length of <geometry> is 'nan'"),
        ("<line/>", "<circle/>", "unknown kind 'circle'"),
        ("<line/>", '<arc curvature="1e4"/>', "turns round many times"),
        ('length="40.0"><line/>', 'length="1e6"><line/>', "1000000 m long"),
        ('a="3" b="0"', 'a="x" b="0"', "a of <width> is 'x'"),
        ('a="3" b="0"', 'a="3" b="1e308"', "b of <width> is '1e308'"),
    ],
)
def test_a_malformed_road_is_left_out_with_a_sentence(
    old: str, new: str, reason: str, tmp_path: Path
) -> None:
    good, bad = road("1", 0.0, 40.0, sections("", lane(-1))), road("2", 0.0, 40.0, sections("", lane(-1)))
    assert old in bad
    source = read(tmp_path, good, bad.replace(old, new))
    assert [row.token for row in source.lanes] == ["1_0_-1"]
    assert source.warnings[0].startswith("m.xodr: road '2' is left out: ")
    assert reason in source.warnings[0]
    with pytest.raises(MapError, match="no usable lane"):
        read(tmp_path, bad.replace(old, new))
