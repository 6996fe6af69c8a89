"""Faults anywhere in a map give an error of one sentence, or a map with the fault counted; never a traceback."""

from __future__ import annotations

import copy
import json
import math
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_maps import MapBuilder, crossroads, two_lane_road

from advdiff_sumo.cli.main import main
from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps.convert.sources.nuscenes_map import read_nuscenes_map

WRONG: tuple[Any, ...] = (
    None,
    math.nan,
    math.inf,
    "nowhere",
    -1,
    3.5,
    [],
    {},
    [None],
    [[]],
    {"token": None},
    True,
)


def run_cli(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Convert *path* as a user does; return exit code and output."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sys, "argv", ["advdiff-sumo", "convert", str(path), "-o", str(path.with_name("out.net.xml"))]
        )
        patch.setattr(sys, "path", list(sys.path))
        with pytest.raises(SystemExit) as stop:
            main()
    said = capsys.readouterr()
    return int(stop.value.code or 0), said.out + said.err


def spoiled(change: str) -> dict[str, Any]:
    """Return a map that cannot be used at all."""
    road = MapBuilder()
    road.straight("a", (0.0, 0.0, 0.0), 40.0)
    data = road.data
    if change == "older":
        data["version"] = "1.2"
    elif change == "no arc lines":
        del data["arcline_path_3"]
    elif change == "empty map":
        data["lane"] = []
    elif change == "NaN everywhere":
        data["arcline_path_3"]["a"][0]["start_pose"] = [math.nan] * 3
    elif change == "null tokens":
        data["lane"][0]["token"] = None
    elif change == "ids that exist nowhere":
        data["lane"][0]["token"] = "nowhere"  # noqa: S105 - the name of a lane
    return data


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ("older", "v1.2"),
        ("no arc lines", "arcline_path_3"),
        ("empty map", "no lane"),
        ("NaN everywhere", "centre line"),
        ("null tokens", "centre line"),
        ("ids that exist nowhere", "centre line"),
    ],
)
def test_one_sentence_with_file_place_and_remedy(
    change: str, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "city.json"
    path.write_text(json.dumps(spoiled(change)), encoding="utf-8")
    code, said = run_cli(path, capsys)
    assert code == 2
    assert "city.json" in said
    assert place in said
    assert "; " in said  # problem; remedy
    assert "Traceback" not in said
    assert not path.with_name("out.net.xml").exists()


def test_a_gigabyte_is_refused_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "huge.json"
    with path.open("wb") as file:
        os.truncate(file.fileno(), 1_000_000_000)  # sparse: takes no space
    code, said = run_cli(path, capsys)
    assert code == 2
    assert "huge.json: 1000 MB" in said


def test_small_faults_are_told_and_the_rest_is_converted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    road = two_lane_road()
    road.straight("nan", (0.0, 0.0, 0.0), 30.0)
    road.data["arcline_path_3"]["nan"][0]["segment_length"][1] = math.nan
    road.data["lane"].append(copy.deepcopy(road.data["lane"][0]))
    road.data["lane"].append({"token": None})
    road.data["connectivity"]["d"]["outgoing"].append("nowhere")
    bow = road.polygon([(100.0, 98.0), (180.0, 102.0), (180.0, 98.0), (100.0, 102.0)])
    road.data["lane"][1]["polygon_token"] = bow
    code, said = run_cli(road.write(tmp_path / "city.json"), capsys)
    assert code == 0
    for words in ("'nan' is left out", "null or occurs twice", "'nowhere'", f"'{bow}' crosses itself"):
        assert words in said
    figures = json.loads((tmp_path / "out.fidelity.json").read_text("utf-8"))
    mended = figures["mended_and_cut"]
    assert mended["lane token unusable"] == 2
    assert mended["lane with unusable arc line"] == 1
    assert mended["link to unknown lane"] == 1
    assert mended["polygon crosses itself"] >= 1
    assert figures["lanes"]["lost"] == []


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the path of every value inside nested containers."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    found = [path] if path else []
    for key, inner in items:
        found += places(inner, (*path, key))
    return found


def sample() -> dict[str, Any]:
    """Return a map that has every layer."""
    cross = crossroads()
    cross.dashed([(40.0, 102.0), (90.0, 102.0)])
    for layer in ("ped_crossing", "walkway", "carpark_area", "stop_line", "road_segment"):
        cross.area(layer, [(80.0, 95.0), (83.0, 95.0), (83.0, 105.0), (80.0, 105.0)])
    tokens = [row["polygon_token"] for row in cross.data["lane"]]
    cross.data["drivable_area"] = [{"token": "drivable", "polygon_tokens": tokens}]
    cross.data["line"].append({"token": "l", "node_tokens": ["node0", "node1"]})
    cross.data["traffic_light"].append({"token": "t", "line_token": "l"})
    cross.data["stop_line"][0].update({"stop_line_type": "TRAFFIC_LIGHT", "traffic_light_tokens": []})
    return cross.data


SAMPLE = sample()
PLACES = places(SAMPLE)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(PLACES), st.sampled_from(WRONG)), min_size=1, max_size=3))
def test_any_wrong_value_anywhere(faults: list[tuple[tuple[Any, ...], Any]]) -> None:
    data = copy.deepcopy(SAMPLE)
    for where, wrong in faults:
        holder: Any = data
        try:
            for key in where[:-1]:
                holder = holder[key]
            holder[where[-1]] = copy.deepcopy(wrong)
        except (TypeError, KeyError, IndexError):
            continue  # an earlier fault has removed this place
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "city.json"
        path.write_text(json.dumps(data), encoding="utf-8")
        sentence = ""
        try:
            source = read_nuscenes_map(path)
        except MapError as error:
            sentence = str(error)
        if sentence:
            assert "city.json" in sentence
            assert "\n" not in sentence
        else:
            assert source.lanes
            assert all(lane.centre_m.shape[1:] == (2,) for lane in source.lanes)
