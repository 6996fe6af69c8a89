"""Files that cannot be used are refused with one sentence; small faults are counted and reported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_maps import MapBuilder, two_lane_road

from advdiff_sumo.core.errors import MapError
from advdiff_sumo.core.map_files import MAX_FILE_BYTES
from advdiff_sumo.maps.convert import convert_map
from advdiff_sumo.maps.convert.sources.nuscenes_map import read_nuscenes_map
from advdiff_sumo.maps.convert.sources.scenarionet_map import read_record_map
from advdiff_sumo.maps.convert.sources.source_map import StatedSizes
from advdiff_sumo.sim.source_maps import read_source

ROOT = Path(__file__).resolve().parents[3]


def _drop(layer: str) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.pop(layer)


def _set(layer: str, value: object) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.__setitem__(layer, value)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_set("version", "1.2"), "older than v1.3"),
        (_drop("arcline_path_3"), "arcline_path_3"),
        (_set("arcline_path_3", {}), "empty"),
        (_drop("connectivity"), "connectivity"),
        (_set("lane", []), "centre line|no lane"),
        (_set("node", 3), "node"),
    ],
)
def test_unusable_expansions(tmp_path: Path, spoil: Callable[[dict[str, Any]], None], words: str) -> None:
    road = MapBuilder()
    road.straight("a", (0.0, 0.0, 0.0), 40.0)
    path = road.write(tmp_path / "m.json")
    spoil(road.data)
    path.write_text(json.dumps(road.data), encoding="utf-8")
    with pytest.raises(MapError, match=words) as caught:
        convert_map(path, tmp_path / "m.net.xml")
    assert "m.json" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"type": "FeatureCollection"}', "\x00\x01"])
def test_files_of_another_format(tmp_path: Path, text: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MapError, match=r"other\.json"):
        convert_map(path, tmp_path / "m.net.xml")


def test_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.json"
    with path.open("wb") as file:
        os.truncate(file.fileno(), MAX_FILE_BYTES + 1)  # sparse: takes no space
    with pytest.raises(MapError, match="more than any map expansion"):
        convert_map(path, tmp_path / "m.net.xml")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="cannot be read"):
        convert_map(tmp_path / "none.json", tmp_path / "m.net.xml")


def test_small_faults_are_counted_and_told(tmp_path: Path) -> None:
    road = two_lane_road()
    road.data["connectivity"]["c"]["outgoing"].append("nowhere")
    road.data["lane"].append({"token": None})
    road.data["lane"].append(dict(road.data["lane"][0]))
    road.data["lane"].append({"token": "bare", "polygon_token": road.data["lane"][0]["polygon_token"]})
    road.data["node"].append({"token": "bad", "x": float("nan"), "y": 0.0})
    bow = road.polygon([(0.0, 0.0), (4.0, 4.0), (4.0, 0.0), (0.0, 4.0)])
    road.data["ped_crossing"].append({"token": "bow", "polygon_token": bow})
    source = read_nuscenes_map(road.write(tmp_path / "m.json"))
    assert source.notes["link to unknown lane"] == 1
    assert source.notes["lane token unusable"] == 2
    assert source.notes["lane without arc line"] == 1
    assert source.notes["node not finite"] == 1
    assert source.notes["polygon crosses itself"] == 1
    assert len(source.warnings) == 5  # one sentence for each of them
    assert len(source.lanes) == 6


@pytest.mark.parametrize(
    "record", [None, {}, {"map_features": {}}, {"map_features": {"1": {"type": "LANE_FREEWAY"}}}]
)
def test_records_without_a_map(record: object) -> None:
    with pytest.raises(MapError, match=r"r\.pkl"):
        read_record_map(record, Path("r.pkl"))


def test_lanes_and_links_of_a_record_that_cannot_be_used_are_stated() -> None:
    """Lane 2 has one point: it is left out, and so are two of three links inside; the one to "far" is no link."""
    line = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    features = {
        "1": {"type": "LANE_SURFACE_STREET", "polyline": line, "exit_lanes": ["2", "3"]},
        "2": {"type": "LANE_SURFACE_STREET", "polyline": line[:1], "exit_lanes": ["3"]},
        "3": {
            "type": "LANE_FREEWAY",
            "polyline": line + 50.0,
            "entry_lanes": ["1", "2"],
            "exit_lanes": ["far"],
        },
    }
    source = read_record_map({"map_features": features}, Path("r.pkl"))
    assert (source.stated, source.left_out) == (StatedSizes(lanes=3, links=3), ("2",))
    assert source.links == (("1", "3"),)
    assert source.notes == {"lane without usable centre line": 1, "link to unknown lane": 4}


@pytest.mark.data
def test_a_real_record_of_waymo_states_what_it_drops(adv_data: Path) -> None:
    path = adv_data / "scenarionet" / "sd_training.tfrecord-00000-of-01000_8a346109094cd5aa.pkl"
    source = read_source(path)
    assert source.stated is not None
    assert (len(source.lanes), source.stated.lanes, len(source.left_out)) == (442, 448, 6)
    assert (len(source.links), source.stated.links) == (524, 530)


def test_tool_exits_with_2_and_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text("{}", encoding="utf-8")
    command = [
        sys.executable,
        str(ROOT / "tools" / "convert_nuscenes_map.py"),
        str(path),
        "-o",
        str(tmp_path / "x"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
