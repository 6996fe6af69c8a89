"""Tables of a nuScenes map expansion: records by token, with unusable records counted and reported."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import shapely
from shapely.geometry import Polygon

from advdiff_sumo.core.errors import MapError

Row = Mapping[str, Any]


class MapTables:
    """The layers of one file; unusable items are left out, counted in *notes* and reported in *warnings*.

    Attributes:
        path: the file, for messages.
        data: its layers.
        notes: number of faults of each kind.
        warnings: a sentence for the first fault of each kind.
        nodes: x and y in m by token.
        polygon_rows, line_rows: records by token.
    """

    def __init__(self, path: Path, data: dict[str, Any]) -> None:
        self.path, self.data = path, data
        self.notes: Counter[str] = Counter()
        self.warnings: list[str] = []
        self.nodes = self._nodes()
        self.polygon_rows = self.by_token("polygon")
        self.line_rows = self.by_token("line")

    def warn(self, kind: str, sentence: str) -> None:
        """Count a fault of *kind*, and keep *sentence* if it is the first of its kind."""
        if not self.notes[kind]:
            self.warnings.append(f"{self.path.name}: {sentence}")
        self.notes[kind] += 1

    def rows(self, layer: str) -> list[Row]:
        """Return the records of *layer*; none if the layer is absent."""
        rows = self.data.get(layer) or []
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise MapError(
                self.path, f"layer '{layer}' is no list of records", "give an unchanged expansion file"
            )
        return rows

    def items(self, row: Row, key: str) -> list[Any]:
        """Return the list *key* of a record; an empty list if it is absent."""
        value = row.get(key)
        if not isinstance(value, list | None):
            place = f"record {row.get('token')!r}" if "token" in row else "a record"
            raise MapError(self.path, f"'{key}' of {place} is no list", "give an unchanged expansion file")
        return value or []

    def records(self, row: Row, key: str) -> list[Row]:
        """Return the list *key* of a record, whose items must be records too."""
        items = self.items(row, key)
        if not all(isinstance(item, dict) for item in items):
            place = f"record {row.get('token')!r}" if "token" in row else "a record"
            raise MapError(
                self.path, f"'{key}' of {place} is no list of records", "give an unchanged expansion file"
            )
        return items

    def by_token(self, layer: str) -> dict[str, Row]:
        """Return the records of *layer* by token; of several with the same token, the first."""
        table: dict[str, Row] = {}
        for row in self.rows(layer):
            token = row.get("token")
            if token is None:
                self.notes[f"{layer} without token"] += 1
            elif str(token) in table:
                self.warn(
                    f"duplicate {layer} token", f"{layer} token {token!r} occurs twice; the first one is used"
                )
            else:
                table[str(token)] = row
        return table

    def _nodes(self) -> dict[str, tuple[float, float]]:
        nodes: dict[str, tuple[float, float]] = {}
        for row in self.rows("node"):
            token, x, y = row.get("token"), row.get("x"), row.get("y")
            if not finite(x, y):
                self.warn(
                    "node not finite",
                    f"node {token!r} has no finite x and y; polygons that use it are left out",
                )
            elif token is not None:
                nodes[str(token)] = (float(x), float(y))  # type: ignore[arg-type]  # checked by finite
        return nodes

    def points(self, tokens: Iterable[Any], what: str) -> list[tuple[float, float]] | None:
        """Return the points in m of nodes *tokens*; None if one is unusable. *what* names their user in the warning."""
        names = [str(token) for token in tokens]
        missing = next((name for name in names if name not in self.nodes), None)
        if missing is not None:
            self.warn("unknown node", f"{what} names node {missing!r}, which is not usable; it is left out")
            return None
        return [self.nodes[name] for name in names]

    def polygon(self, token: Any) -> Polygon | None:
        """Return the polygon named *token*, repaired if it crosses itself; None if it is unusable."""
        row = self.polygon_rows.get(str(token))
        if row is None:
            self.warn("unknown polygon", f"polygon {token!r} does not exist")
            return None
        outer = self.points(self.items(row, "exterior_node_tokens"), f"polygon {token!r}")
        if outer is None or len(outer) < 3:
            self.notes["polygon with under three nodes"] += outer is not None
            return None
        rings = [
            self.points(self.items(hole, "node_tokens"), f"polygon {token!r}")
            for hole in self.records(row, "holes")
        ]
        polygon = Polygon(outer, [ring for ring in rings if ring is not None and len(ring) >= 3])
        return self._repaired(polygon, token)

    def _repaired(self, polygon: Polygon, token: Any) -> Polygon | None:
        if polygon.is_valid:
            return polygon if polygon.area > 0 else None
        self.warn(
            "polygon crosses itself", f"polygon {token!r} crosses itself; its largest valid part is used"
        )
        parts = [p for p in shapely.get_parts(shapely.make_valid(polygon)) if isinstance(p, Polygon)]
        parts += [
            q
            for p in shapely.get_parts(shapely.make_valid(polygon))
            for q in getattr(p, "geoms", [])
            if isinstance(q, Polygon)
        ]
        return max(parts, key=lambda part: part.area, default=None)


def finite(*values: object) -> bool:
    """Return whether all *values* are finite numbers."""
    return all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in values)
