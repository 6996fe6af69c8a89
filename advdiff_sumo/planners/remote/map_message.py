"""Convert a road map to a ``Map`` message."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from typing import Any

import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Junction, Lane, Link
from advdiff_sumo.maps.sidecar import sidecar_of
from advdiff_sumo.planner_kit import messages


@lru_cache(maxsize=4)
def map_id_of(road: RoadMap) -> str:
    """Return a digest of the net file of *road* and of its drivable area."""
    digest = hashlib.sha256(road.path.read_bytes())
    area = sidecar_of(road.path)
    if area is not None:
        digest.update(area.read_bytes())
    return digest.hexdigest()[:16]


def map_message(road: RoadMap) -> Any:
    """Return *road* as a ``Map`` message."""
    return messages.Map(
        map_id=map_id_of(road),
        net_path=str(road.path.resolve()),
        lefthand=road.lefthand,
        lanes=[_lane(lane) for lane in road.lanes.values()],
        links=[_link(link) for lane in road.lanes.values() for link in lane.successors],
        junctions=[_junction(junction) for junction in road.junctions.values()],
        drivable_area=[_polygon(part) for part in shapely.get_parts(road.drivable)],
    )


def _lane(lane: Lane) -> Any:
    x, y = lane.centre_xy_m.T.tolist()
    return messages.Lane(
        id=lane.id,
        edge_id=lane.edge_id,
        index=lane.index,
        x_m=x,
        y_m=y,
        width_m=lane.width_m,
        speed_limit_mps=lane.speed_mps,
        length_m=lane.length_m,
        internal=lane.is_internal,
        left_id=lane.left_id or "",
        right_id=lane.right_id or "",
        allows=sorted(lane.allows),
    )


def _link(link: Link) -> Any:
    return messages.Link(
        from_lane=link.from_lane,
        to_lane=link.to_lane,
        via=link.via,
        direction=link.direction,
        state=link.state,
        signal_id=link.tls_id or "",
        signal_index=link.tls_index or 0,
        junction_id=link.junction_id,
        request=link.request_index,
    )


def _junction(junction: Junction) -> Any:
    x, y = junction.shape_xy_m.reshape(-1, 2).T.tolist()
    rows = [
        messages.RightOfWay(request=k, foes=sorted(foes), yields_to=sorted(junction.response.get(k, ())))
        for k, foes in sorted(junction.foes.items())
    ]
    return messages.Junction(id=junction.id, type=junction.type, x_m=x, y_m=y, right_of_way=rows)


def _polygon(part: Any) -> Any:
    outline, *holes = (_ring(shapely.get_coordinates(ring)) for ring in shapely.get_rings(part))
    return messages.Polygon(outline=outline, holes=holes)


def _ring(xy_m: FloatArray) -> Any:
    x, y = xy_m.T.tolist()
    return messages.Ring(x_m=x, y_m=y)
