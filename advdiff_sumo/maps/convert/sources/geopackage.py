"""Read layers of a GeoPackage (OGC 12-128r19): SQLite tables with shapes in degrees."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pyproj
import shapely
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import MapError, os_reason
from advdiff_sumo.core.map_files import MAX_FILE_BYTES
from advdiff_sumo.maps.convert.sources.bounded_lanes import on_earth

ENVELOPE_BYTES = (0, 32, 48, 48, 64)  # length of the envelope by its code in the header
SHAPE_COLUMNS = ("geom", "geometry")
Row: TypeAlias = dict[str, Any]


def read_layers(path: Path, layers: Mapping[str, Sequence[str]], remedy: str) -> dict[str, list[Row]]:
    """Return the records of those *layers* that the GeoPackage *path* holds, by layer.

    Args:
        path: the file.
        layers: columns that each layer must have; a layer without required columns may be missing.
        remedy: advice for the error message if the file cannot be used.

    Raises:
        MapError: the file is no GeoPackage, or a layer or column is missing.
    """
    _check_file(path, remedy)
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as base:
            tables = {row[0] for row in base.execute("SELECT name FROM sqlite_master WHERE type='table'")}
            rows = {name: _rows(base, name) for name in layers if name in tables}
    except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter if SQLite's own text is damaged
        raise MapError(path, f"is no GeoPackage ({error})", remedy) from None
    for name, needed in layers.items():
        if needed and name not in rows:
            raise MapError(path, f"layer '{name}' is missing", remedy)
        missing = next((column for column in needed if column not in rows[name][0]), None)
        if missing is not None:
            raise MapError(path, f"layer '{name}' has no column '{missing}'", remedy)
    return {name: records for name, (_, records) in rows.items()}


def _check_file(path: Path, remedy: str) -> None:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise MapError(path, f"cannot be read ({os_reason(error)})", remedy) from None
    if path.is_dir():
        raise MapError(path, "is a folder", remedy)
    if size == 0:
        raise MapError(path, "is empty", remedy)
    if size > MAX_FILE_BYTES:
        raise MapError(path, f"{size / 1e6:.0f} MB is more than any map has", remedy)


def _rows(base: sqlite3.Connection, name: str) -> tuple[list[str], list[Row]]:
    """Return the columns and records of a table."""
    cursor = base.execute(f'SELECT * FROM "{name}"')  # noqa: S608 - the name is a constant of this package
    columns = [column[0] for column in cursor.description]
    return columns, [dict(zip(columns, row, strict=True)) for row in cursor]


def name_of(value: Any) -> str | None:
    """Return the id by which records refer to each other as text; integers stored as floats give the same text."""
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() else None
    return str(value) if isinstance(value, int | str) and value != "" else None


def shape_of(row: Row, from_degrees: pyproj.Transformer) -> BaseGeometry | None:
    """Return the shape of a record in m, or None if it is unusable."""
    value = next((row[column] for column in SHAPE_COLUMNS if column in row), None)
    try:
        with np.errstate(invalid="ignore"):  # NaN is checked below
            shape = shapely.from_wkb(_wkb(value))
    except (shapely.errors.ShapelyError, ValueError, TypeError, struct.error, IndexError):
        return None
    if shape.is_empty:
        return None

    def to_metres(degrees: FloatArray) -> FloatArray:
        xy = np.stack(from_degrees.transform(degrees[:, 0], degrees[:, 1]), axis=-1)
        return on_earth(np.where(np.isfinite(xy), xy, np.nan))

    shape_m = shapely.transform(shapely.force_2d(shape), to_metres)
    return shape_m if np.isfinite(shapely.get_coordinates(shape_m)).all() else None


def _wkb(value: Any) -> bytes:
    """Return the well-known binary that follows the header of a GeoPackage geometry."""
    if not isinstance(value, bytes) or value[:2] != b"GP":
        raise ValueError("no geometry of a GeoPackage")
    return value[8 + ENVELOPE_BYTES[(value[3] >> 1) & 7] :]
