"""Small nets, made by netconvert from a few lines, of which every number can be worked by hand."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import sumo

NODES = """<nodes>
<node id="C" x="0" y="0" type="{kind}"/>
<node id="W" x="-100" y="0"/><node id="E" x="100" y="0"/><node id="N" x="0" y="100"/><node id="S" x="0" y="-100"/>
</nodes>"""

EDGES = """<edges>
<edge id="WC" from="W" to="C" numLanes="2" speed="14" priority="2"/>
<edge id="CE" from="C" to="E" numLanes="2" speed="14" priority="2"/>
<edge id="EC" from="E" to="C" numLanes="1" speed="14" priority="2"/>
<edge id="CW" from="C" to="W" numLanes="1" speed="14" priority="2"/>
<edge id="SC" from="S" to="C" numLanes="1" speed="10" priority="1"/>
<edge id="CS" from="C" to="S" numLanes="1" speed="10" priority="1"/>
<edge id="NC" from="N" to="C" numLanes="1" speed="10" priority="1"/>
<edge id="CN" from="C" to="N" numLanes="1" speed="10" priority="1"/>
</edges>"""


@pytest.fixture(scope="session")
def make_cross(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return a maker of crossings: a two-lane major road from the west, single lanes else, arms of 100 m.

    Lane centres lie 1.6 m and 4.8 m from the axes; extra netconvert options may be given.
    """

    def make(*options: str, kind: str = "priority") -> Path:
        folder = tmp_path_factory.mktemp("cross")
        (folder / "c.nod.xml").write_text(NODES.format(kind=kind))
        (folder / "c.edg.xml").write_text(EDGES)
        net = folder / "cross.net.xml"
        command = [str(Path(sumo.SUMO_HOME) / "bin" / "netconvert"), "-n", str(folder / "c.nod.xml")]
        command += ["-e", str(folder / "c.edg.xml"), "-o", str(net), "--no-turnarounds"]
        command += ["--offset.disable-normalization", "true", *options]
        subprocess.run(command, check=True, capture_output=True)
        return net

    return make


@pytest.fixture(scope="session")
def cross(make_cross: Callable[..., Path]) -> Path:
    """Return the net of the right-hand crossing."""
    return make_cross()


@pytest.fixture(scope="session")
def cross_left(make_cross: Callable[..., Path]) -> Path:
    """Return the net of the left-hand crossing."""
    return make_cross("--lefthand", "true")
