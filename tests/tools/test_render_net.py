"""Pictures of nets that differ from the shipped ones."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import sumolib
from matplotlib.image import imread

TOOL = Path(__file__).resolve().parents[2] / "tools" / "render_net.py"
NOTCHED = """<edges><edge id="e" from="a" to="b" numLanes="2" shape="0,0 40,0 41,-3 42,0 80,0"/></edges>"""
AREA = """<additional>
  <poly id="d" type="drivable_area" color="0.4,0.4,0.4" fill="1" layer="0" shape="0,-9 1,-9 1,-8"/>
</additional>"""
NODES = """<nodes><node id="a" x="0" y="0"/><node id="b" x="80" y="0"/></nodes>"""


def drawn(net: Path) -> bytes:
    picture = net.with_suffix(".png")
    command = [sys.executable, str(TOOL), str(net), "-o", str(picture), "--pixels", "300"]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return picture.read_bytes()


def test_streets_beyond_the_rim_are_drawn_where_the_side_car_has_no_area(tmp_path: Path) -> None:
    (tmp_path / "n.nod.xml").write_text(NODES, encoding="utf-8")
    (tmp_path / "e.edg.xml").write_text(
        NOTCHED.replace('id="e"', 'id="e" type="beyond_rim"'), encoding="utf-8"
    )
    (tmp_path / "notch.poly.xml").write_text(AREA, encoding="utf-8")
    net = tmp_path / "notch.net.xml"
    files = ["-n", str(tmp_path / "n.nod.xml"), "-e", str(tmp_path / "e.edg.xml"), "-o", str(net)]
    subprocess.run([sumolib.checkBinary("netconvert"), *files], check=True, capture_output=True)
    pixels = np.round(255 * imread(io.BytesIO(drawn(net)), format="png")[..., :3])
    assert (pixels == (0xA9, 0xAD, 0xB2)).all(axis=-1).mean() > 0.05


def test_a_net_of_single_lanes(tmp_path: Path) -> None:
    net = tmp_path / "grid.net.xml"
    command = [sumolib.checkBinary("netgenerate"), "--grid", "--grid.number", "2", "-L", "1", "-o", str(net)]
    subprocess.run(command, check=True, capture_output=True)
    assert drawn(net).startswith(b"\x89PNG")


def test_a_lane_with_a_bend_narrower_than_its_width(tmp_path: Path) -> None:
    (tmp_path / "n.nod.xml").write_text(NODES, encoding="utf-8")
    (tmp_path / "e.edg.xml").write_text(NOTCHED, encoding="utf-8")
    net = tmp_path / "notch.net.xml"
    files = ["-n", str(tmp_path / "n.nod.xml"), "-e", str(tmp_path / "e.edg.xml"), "-o", str(net)]
    subprocess.run([sumolib.checkBinary("netconvert"), *files], check=True, capture_output=True)
    assert drawn(net).startswith(b"\x89PNG")
