"""Read any map that can be converted; those of ScenarioNet records in the frame of their drives."""

from __future__ import annotations

from pathlib import Path

from advdiff_sumo.core.errors import MapError
from advdiff_sumo.data.pickles import load_plain
from advdiff_sumo.data.scenarionet_log import map_offset_m
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.maps.convert.sources.scenarionet_map import read_record_map
from advdiff_sumo.maps.convert.sources.source_map import SourceMap


def read_source(path: Path) -> SourceMap:
    """Return the map in *path*; that of a nuScenes record is placed where the data set's own map is.

    Raises:
        InputError: the file cannot be read, has no known format, or contains nothing usable.
    """
    if path.suffix != ".pkl":
        return read_map(path)
    record = load_plain(path)
    if not (isinstance(record, dict) and "metadata" in record and "tracks" in record):
        return read_record_map(record, path)
    try:
        offset = map_offset_m(record)
    except (AttributeError, KeyError, TypeError, ValueError, IndexError) as error:
        problem = f"does not tell its frame ({type(error).__name__}: {error})"
        raise MapError(path, problem, "convert the record again") from None
    return read_record_map(record, path, None if offset is None else (float(offset[0]), float(offset[1])))
