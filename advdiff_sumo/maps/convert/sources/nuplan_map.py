"""Read nuPlan maps (Caesar et al. 2021, arXiv:2106.11810): ``map.gpkg``, a GeoPackage of one city.

Shapes in the file are in degrees. The source map is in the projected system that the layer ``meta`` names, in m.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyproj
import shapely
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps.convert.projection import projection_from
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats
from advdiff_sumo.maps.convert.sources.bounded_lanes import LONGEST_M, as_multi, largest_valid
from advdiff_sumo.maps.convert.sources.geopackage import Row, name_of, read_layers, shape_of
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults
from advdiff_sumo.maps.convert.sources.source_map import SourceLane, SourceMap, StatedSizes

REMEDY = "give an unchanged map.gpkg of nuPlan"
CONNECTOR_AREAS = "gen_lane_connectors_scaled_width_polygons"
LAYERS = {
    "meta": ("key", "value"),
    "baseline_paths": ("lane_fid", "lane_connector_fid"),
    "lanes_polygons": ("lane_fid",),
    "lane_connectors": ("fid", "exit_lane_fid", "entry_lane_fid"),
    **dict.fromkeys((CONNECTOR_AREAS, "generic_drivable_areas", "intersections", "crosswalks"), ()),
    **dict.fromkeys(("walkways", "carpark_areas"), ()),
}


def nuplan_map(path: Path) -> SourceMap:
    """Return the map in the GeoPackage *path*.

    Baseline paths are the centre lines. A lane connector joins its exit lane to its entry lane.

    Raises:
        MapError: the file is no GeoPackage, a layer or column is missing, or no lane is usable.
    """
    rows = read_layers(path, LAYERS, REMEDY)
    projection = _projection(rows["meta"], path)
    layers = _Layers(rows, pyproj.Transformer.from_crs("EPSG:4326", projection, always_xy=True))
    faults = MapFaults(path)
    lanes = list(_lanes(layers, faults))
    if not lanes:
        raise MapError(path, "holds no lane with a usable baseline path", REMEDY)
    known = {lane.token for lane in lanes}
    links = list(_links(rows["lane_connectors"]))
    stated_tokens = [token for token, *_ in _stated_lanes(rows)]
    return SourceMap(
        path=path,
        location=path.absolute().parent.parent.name or path.stem,
        lanes=tuple(lanes),
        links=tuple(_known_links(links, set(stated_tokens), known, faults)),
        drivable=as_multi(shapely.union_all(layers.areas("generic_drivable_areas"))),
        intersections=layers.areas("intersections"),
        crossings=layers.areas("crosswalks"),
        walkways=layers.areas("walkways"),
        carparks=layers.areas("carpark_areas"),
        stated=StatedSizes(len(stated_tokens), len(links)),
        left_out=tuple(token for token in dict.fromkeys(stated_tokens) if token not in known),
        notes=faults.notes,
        warnings=faults.sentences(),
        projection=projection,
    )


def _projection(meta: list[Row], path: Path) -> str:
    names = [row["value"] for row in meta if row["key"] == "projectedCoordSystem"]
    if not names:
        raise MapError(path, "layer 'meta' has no projectedCoordSystem", REMEDY)
    try:
        return projection_from(str(names[0]))
    except ValueError as error:
        raise MapError(
            path, f"projectedCoordSystem {str(names[0])[:40]!r} in layer 'meta' {error}", REMEDY
        ) from None


@dataclass(frozen=True, eq=False)
class _Layers:
    """Records by layer, and the transformation of their shapes from degrees to m."""

    rows: dict[str, list[Row]]
    from_degrees: pyproj.Transformer

    def shape(self, row: Row | None) -> BaseGeometry | None:
        """Return the shape of a record in m, or None if it is unusable."""
        return shape_of(row, self.from_degrees) if row is not None else None

    def by_name(self, layer: str, key: str) -> dict[str, Row]:
        """Return the records of *layer* by the id in column *key*."""
        named = ((name_of(row.get(key)), row) for row in self.rows.get(layer, []))
        return {name: row for name, row in named if name is not None}

    def areas(self, layer: str) -> tuple[Polygon, ...]:
        """Return the areas of *layer*; none if the layer is missing."""
        shapes = [shape for row in self.rows.get(layer, []) if (shape := self.shape(row)) is not None]
        return tuple(part for shape in shapes for part in as_multi(shapely.make_valid(shape)).geoms)


def _stated_lanes(rows: dict[str, list[Row]]) -> Iterator[tuple[str, str | None, Row]]:
    """Yield token, id and record of each lane and connector."""
    for row in rows["lanes_polygons"]:
        yield f"lane_{name_of(row['lane_fid'])}", name_of(row["lane_fid"]), row
    for row in rows["lane_connectors"]:
        yield f"connector_{name_of(row['fid'])}", name_of(row["fid"]), row


def _lanes(layers: _Layers, faults: MapFaults) -> Iterator[SourceLane]:
    """Yield the usable lanes; the others are left out and noted in *faults*."""
    keys = {"lane": "lane_fid", "connector": "lane_connector_fid"}
    paths = {kind: layers.by_name("baseline_paths", key) for kind, key in keys.items()}
    areas = layers.by_name(CONNECTOR_AREAS, keys["connector"])
    used: set[str] = set()
    for token, name, row in _stated_lanes(layers.rows):
        kind = token.partition("_")[0]
        if name is None or token in used:
            faults.add(
                "lane id unusable",
                f"a {kind} is left out: its id is null, no name or occurs twice ({token!r})",
            )
            continue
        used.add(token)
        lane = _lane(
            token,
            layers.shape(paths[kind].get(name)),
            layers.shape(row if kind == "lane" else areas.get(name)),
            row.get("speed_limit_mps"),
        )
        if lane is None:
            faults.add("lane without baseline path", f"{token} has no usable baseline path and is left out")
        else:
            yield lane


def _lane(
    token: str, line: BaseGeometry | None, area: BaseGeometry | None, speed: object
) -> SourceLane | None:
    """Return a lane with centre line *line* and polygon *area*; None if the line is unusable."""
    if line is not None and line.geom_type == "MultiLineString":
        line = shapely.line_merge(line)
    if not isinstance(line, LineString) or line.length > LONGEST_M:
        return None
    centre = drop_repeats(np.asarray(line.coords)[:, :2])
    if len(centre) < 2:
        return None
    return SourceLane(
        token=token,
        is_connector=token.startswith("connector_"),
        centre_m=centre,
        polygon=largest_valid(area),
        speed_mps=float(speed) if isinstance(speed, int | float) and 0.0 < speed < 100.0 else None,
    )


def _links(connectors: list[Row]) -> Iterator[tuple[str, str]]:
    """Yield the links from lanes to connectors and from connectors to lanes."""
    for row in connectors:
        name = f"connector_{name_of(row['fid'])}"
        yield f"lane_{name_of(row['exit_lane_fid'])}", name
        yield name, f"lane_{name_of(row['entry_lane_fid'])}"


def _known_links(
    links: list[tuple[str, str]], stated_tokens: set[str], known: set[str], faults: MapFaults
) -> Iterator[tuple[str, str]]:
    """Yield the links between *known* lanes; links to lanes that are not in the file are noted in *faults*."""
    for link in dict.fromkeys(links):
        missing = next((token for token in link if token not in stated_tokens), None)
        if missing is not None:
            other = next(token for token in link if token != missing)
            faults.add("link to unknown lane", f"{other} names {missing}, which is not in the file")
        elif set(link) <= known:
            yield link
