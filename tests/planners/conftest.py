"""Small nets and scenes for planners."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import sumo  # type: ignore[import-untyped]

from advdiff_sumo.maps import RoadMap

_ARM_M = 200
_ARMS = {"west": (-_ARM_M, 0), "east": (_ARM_M, 0), "south": (0, -_ARM_M), "north": (0, _ARM_M)}


@pytest.fixture(scope="session")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., RoadMap]:
    """Return a maker of crossings at (0, 0): two lanes each way west-east (13.89 m/s), one south-north.

    The road from the north begins at *north*.
    """
    made: dict[tuple[str, bool, tuple[int, int]], RoadMap] = {}

    def make(
        kind: str = "priority", lefthand: bool = False, north: tuple[int, int] = _ARMS["north"]
    ) -> RoadMap:
        if (kind, lefthand, north) not in made:
            folder = tmp_path_factory.mktemp(f"{kind}-{lefthand}")
            made[kind, lefthand, north] = RoadMap.read(_write(folder, kind, lefthand, north))
        return made[kind, lefthand, north]

    return make


def _write(folder: Path, kind: str, lefthand: bool, north: tuple[int, int]) -> Path:
    arms = {**_ARMS, "north": north}
    nodes = [f'<node id="{name}" x="{x}" y="{y}" type="dead_end"/>' for name, (x, y) in arms.items()]
    edges = []
    for name in _ARMS:
        major = name in ("west", "east")
        attributes = f'numLanes="{2 if major else 1}" priority="{3 if major else 1}" speed="13.89"'
        edges += [
            f'<edge id="{name}_in" from="{name}" to="c" {attributes}/>',
            f'<edge id="{name}_out" from="c" to="{name}" {attributes}/>',
        ]
    (folder / "n.nod.xml").write_text(
        f'<nodes><node id="c" x="0" y="0" type="{kind}"/>{"".join(nodes)}</nodes>'
    )
    (folder / "n.edg.xml").write_text(f"<edges>{''.join(edges)}</edges>")
    net = folder / "crossing.net.xml"
    subprocess.run(
        [
            str(Path(sumo.SUMO_HOME, "bin/netconvert")),
            "--node-files=n.nod.xml",
            "--edge-files=n.edg.xml",
            f"--output-file={net}",
            "--no-turnarounds=true",
            "--offset.disable-normalization=true",
            f"--lefthand={'true' if lefthand else 'false'}",
        ],
        cwd=folder,
        check=True,
        capture_output=True,
    )
    return net
