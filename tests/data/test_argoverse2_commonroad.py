"""Logs that come along with Argoverse 2 and CommonRoad maps."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from advdiff_sumo.core.errors import LogError
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.data import Argoverse2Reader, CommonRoadReader, open_log
from advdiff_sumo.data.argoverse2_log import COLUMNS

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "maps" / "convert"))
import small_sources


def write_scenario(path: Path, more: Iterable[tuple[object, ...]] = (), **changes: object) -> Path:
    """Write the recording vehicle at 10 m/s eastwards, someone on foot from step 5 on, and a bollard."""
    rows = [("AV", "vehicle", k, 1.0 * k, 0.0, 0.0, 10.0, 0.0) for k in range(20)]
    rows += [("7", "pedestrian", k, 5.0, 4.0 + 0.1 * k, 0.5 * np.pi, 0.0, 1.0) for k in range(5, 20)]
    rows += [("8", "static", k, 9.0, 9.0, 0.0, 0.0, 0.0) for k in range(20)]
    rows += list(more)
    table = {name: list(values) for name, values in zip(COLUMNS, zip(*rows, strict=True), strict=True)}
    table.update(changes)
    pq.write_table(pa.table({key: value for key, value in table.items() if value is not None}), path)
    return path


def test_argoverse2_tracks(tmp_path: Path) -> None:
    path = write_scenario(tmp_path / "scenario_x.parquet")
    reader = open_log(path)
    assert isinstance(reader, Argoverse2Reader)
    (scene,) = reader.scenes()
    assert (scene.name, scene.location) == ("x", "log_map_archive_x")
    assert scene.tracks.ids == ("AV", "7")
    assert scene.ego == 0
    assert scene.tracks.classes.tolist() == [AgentClass.CAR, AgentClass.PEDESTRIAN]
    assert scene.tracks.valid[1].tolist() == [False] * 5 + [True] * 15
    assert scene.tracks.speed_mps[0] == pytest.approx(np.full(20, 10.0))
    assert scene.tracks.speed_mps[1, 5:] == pytest.approx(np.full(15, 1.0))


def test_argoverse2_parks_whom_the_log_calls_standing_while_its_box_wanders(tmp_path: Path) -> None:
    def wanderer(name: str, kind: str, fastest_mps: float) -> list[tuple[object, ...]]:
        speeds = [fastest_mps if k == 10 else 0.0 for k in range(20)]
        return [
            (name, kind, k, 20.0, 3.0 * np.sin(0.3 * k), 0.5 * np.pi, 0.0, v) for k, v in enumerate(speeds)
        ]

    agents = (("stands", "vehicle", 0.4), ("drives", "vehicle", 0.6), ("walks", "pedestrian", 0.4))
    rows = [row for agent in agents for row in wanderer(*agent)]
    (scene,) = Argoverse2Reader(write_scenario(tmp_path / "scenario_x.parquet", rows)).scenes()
    assert dict(zip(scene.tracks.ids, scene.parked, strict=True)) == {
        "AV": False, "7": False, "stands": True, "drives": False, "walks": False,
    }  # fmt: skip
    (row,) = np.flatnonzero(scene.parked)
    assert scene.tracks.speed_mps[row].tolist() == [0.0] * 20
    assert np.ptp(scene.tracks.xy_m[row], axis=0).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    "changes", [{"heading": None}, {"track_id": ["x"] * 55}, {"position_x": [np.nan] * 55}]
)
def test_argoverse2_damage_is_one_sentence(changes: dict[str, object], tmp_path: Path) -> None:
    path = write_scenario(tmp_path / "scenario_x.parquet", **changes)
    with pytest.raises(LogError, match="scenario_x") as caught:
        Argoverse2Reader(path).read("x")
    assert "\n" not in str(caught.value)


def test_file_that_is_no_parquet(tmp_path: Path) -> None:
    path = tmp_path / "scenario_x.parquet"
    path.write_bytes(b"PAR1 nothing")
    with pytest.raises(LogError, match="no readable Parquet"):
        Argoverse2Reader(path).read("x")


def test_commonroad_tracks(tmp_path: Path) -> None:
    reader = open_log(small_sources.write("commonroad", tmp_path))
    assert isinstance(reader, CommonRoadReader)
    (scene,) = reader.scenes()
    assert scene.tracks.ids == ("100",)
    assert scene.tracks.size_m.tolist() == [[4.5, 1.8]]
    assert scene.tracks.xy_m[0, :, 0] == pytest.approx(5.0 + 0.5 * np.arange(41))
    assert scene.tracks.speed_mps[0] == pytest.approx(np.full(41, 5.0))
    assert scene.tracks.dt_s == 0.1


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        ("<circle><radius>0.3</radius></circle>", [0.6, 0.6]),
        (
            "<polygon><point><x>-4</x><y>-1</y></point><point><x>4</x><y>-1.2</y></point>"
            "<point><x>3</x><y>1.2</y></point></polygon>",
            [8.0, 2.4],
        ),
    ],
)
def test_commonroad_shapes_other_than_rectangles(tmp_path: Path, shape: str, size: list[float]) -> None:
    path, text = tmp_path / "x.xml", small_sources.commonroad()
    start, end = text.index("<rectangle>"), text.index("</rectangle>") + len("</rectangle>")
    path.write_text(text[:start] + shape + text[end:], encoding="utf-8")
    (scene,) = CommonRoadReader(path).scenes()
    assert scene.tracks.size_m.tolist() == [pytest.approx(size)]


def test_commonroad_without_trajectories(tmp_path: Path) -> None:
    path = tmp_path / "x.xml"
    text = small_sources.commonroad()
    start = text.index("<dynamicObstacle")
    path.write_text(text[:start] + "</commonRoad>", encoding="utf-8")
    with pytest.raises(LogError, match="nobody to drive"):
        CommonRoadReader(path).read("x")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("<time><exact>3</exact>", "<time><exact>-3</exact>"), "states before step 0, or two of one step"),
        (("<time><exact>3</exact>", "<time><exact>4</exact>"), "states before step 0, or two of one step"),
        (("</commonRoad>", ""), "x.xml"),
    ],
)
def test_commonroad_with_damaged_states(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    path = tmp_path / "x.xml"
    text = small_sources.commonroad()
    assert change[0] in text
    path.write_text(text.replace(*change, 1), encoding="utf-8")
    with pytest.raises(LogError, match=words):
        CommonRoadReader(path).read("x")


@pytest.mark.data
def test_genuine_logs(adv_data: Path) -> None:
    (scene,) = Argoverse2Reader(adv_data / "argoverse2").scenes()
    assert scene.tracks.steps == 110
    assert scene.tracks.valid[scene.ego].all()
    wandering = [scene.tracks.ids.index(name) for name in ("139310", "139510", "139591", "139613", "139647")]
    assert scene.parked[wandering].all()
    scenes = {scene.name: scene for scene in CommonRoadReader(adv_data / "commonroad").scenes()}
    assert len(scenes) == 4
    assert scenes["USA_Lanker-1_3_T-1"].tracks.agents == 36
