"""Third-party map readers in separate environments (``make readers``): lanes and links as JSON.

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
NUPLAN = """
import json, sys
import geopandas, pyogrio
def layer(name):
    return pyogrio.read_dataframe(sys.argv[1], layer=name, fid_as_index=True)
zone = dict(zip(layer("meta")["key"], layer("meta")["value"]))["projectedCoordSystem"]
lanes = {}
for row in layer("baseline_paths").to_crs(zone).itertuples():
    name = f"lane_{row.lane_fid}" if isinstance(row.lane_fid, str) else f"connector_{row.lane_connector_fid}"
    lanes[name] = [[x, y] for x, y, *_ in row.geometry.coords]
links = []
for row in layer("lane_connectors").itertuples():
    name = f"connector_{row.Index}"
    links += [[f"lane_{row.exit_lane_fid}", name], [name, f"lane_{row.entry_lane_fid}"]]
print(json.dumps({"lanes": lanes, "links": links}))
"""
# Roads of one right lane and one section each, as our exporter writes them: links are those of their roads.
OPENDRIVE = """
import json, sys
from pyxodr.road_objects.network import RoadNetwork
city = RoadNetwork(sys.argv[1], resolution=0.02)  # its arcs fail where they turn by over 6 degrees between two points
lanes, links = {}, []
for road in city.get_roads():
    ((lane,),) = (section.lanes for section in road.lane_sections)
    name = f"{road.id}_0_{lane.id}"
    lanes[name] = lane.traffic_flow_line[:, :2].tolist()
    if road.id in city.connecting_road_ids:
        (before, _), (after, _) = road.predecessor_data, road.successor_data
        links += [[f"{before.id}_0_-1", name], [name, f"{after.id}_0_-1"]]
print(json.dumps({"lanes": lanes, "links": links}))
"""
SCRIPTS = {
    "lanelet2": LANELET2,
    "av2": ARGOVERSE2,
    "commonroad": COMMONROAD,
    "nuplan": NUPLAN,
    "opendrive": OPENDRIVE,
}


def read_outside(reader: str, path: Path) -> dict[str, Any]:
    """Return lanes and links of *path* as *reader* reads them; skip the test if the reader is not installed."""
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
