"""Determine whether traffic keeps left, if the user does not state it."""

from __future__ import annotations

from dataclasses import replace

from advdiff_sumo.core.polylines import Polyline
from advdiff_sumo.maps.convert.projection import drives_left
from advdiff_sumo.maps.convert.sources.source_map import LaneUse, SourceMap
from advdiff_sumo.maps.opposite_lanes import keeps_left, opposite_offsets_m


def with_side_of_the_road(source: SourceMap) -> SourceMap:
    """Return *source* with ``keeps_left`` set: by its own statement, its location, or the positions of its lanes."""
    if source.keeps_left or drives_left(source.location):
        return replace(source, keeps_left=True)
    lines = [
        Polyline.of(lane.centre_m)
        for lane in source.lanes
        if lane.use is not LaneUse.BICYCLE and not lane.is_connector
    ]
    if not keeps_left(opposite_offsets_m(lines)):
        return source
    sentence = (
        f"{source.path.name}: traffic keeps left by where its lanes lie; --righthand says that it does not"
    )
    return replace(source, keeps_left=True, warnings=(*source.warnings, sentence))
