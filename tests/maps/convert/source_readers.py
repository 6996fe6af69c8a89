"""Other people's readers of maps, in environments of their own (``make readers``): lanes and links as JSON.

Each script prints ``{"lanes": {name: [[x, y], …]}, "links": [[from, to], …]}`` for the map that it is given.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.hang_guard import HANG_S

ROOT = Path(__file__).resolve().parents[3]
ARGOVERSE2 = """
import json, sys
from pathlib import Path
from av2.map.map_api import ArgoverseStaticMap
city = ArgoverseStaticMap.from_json(Path(sys.argv[1]))
segments = city.vector_lane_segments
lanes = {str(k): city.get_lane_segment_centerline(k)[:, :2].tolist() for k in segments}
links = [[str(k), str(n)] for k, row in segments.items() for n in row.successors if n in segments]
print(json.dumps({"lanes": lanes, "links": links}))
"""
COMMONROAD = """
import gzip, json, sys, tempfile
from commonroad.common.file_reader import CommonRoadFileReader
with tempfile.NamedTemporaryFile(suffix=".xml") as file:
    file.write(gzip.open(sys.argv[1]).read())
    file.flush()
    scenario, _ = CommonRoadFileReader(file.name).open()
lanelets = scenario.lanelet_network.lanelets
names = {row.lanelet_id for row in lanelets}
lanes = {str(row.lanelet_id): row.center_vertices.tolist() for row in lanelets}
links = [[str(row.lanelet_id), str(n)] for row in lanelets for n in row.successor if n in names]
print(json.dumps({"lanes": lanes, "links": links}))
"""
LANELET2 = """
import json, sys
import lanelet2
from lanelet2.projection import UtmProjector
origin = lanelet2.io.Origin(49.0, 8.4)
base = UtmProjector(origin)
city = lanelet2.io.load(sys.argv[1], base)
rules = lanelet2.traffic_rules.create(
    lanelet2.traffic_rules.Locations.Germany, lanelet2.traffic_rules.Participants.Vehicle)
graph = lanelet2.routing.RoutingGraph(city, rules)
lanes = {str(row.id): [[p.x, p.y] for p in row.centerline] for row in city.laneletLayer}
links = [[str(row.id), str(n.id)] for row in city.laneletLayer for n in graph.following(row)]
print(json.dumps({"lanes": lanes, "links": links}))
"""
SCRIPTS = {"lanelet2": LANELET2, "av2": ARGOVERSE2, "commonroad": COMMONROAD}


def read_outside(reader: str, path: Path) -> dict[str, Any]:
    """Return lanes and links of *path* as *reader* has them; skips where it is not installed."""
    python = ROOT / "build" / "readers" / reader / "bin" / "python"
    if not python.exists():
        pytest.skip(f"{python} is not there: make readers")
    done = subprocess.run(
        [str(python), "-c", SCRIPTS[reader], str(path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=HANG_S,
    )
    assert done.returncode == 0, done.stderr
    answer: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return answer
