"""ScenarioNet records: made by hand, and against the nuScenes tables of the same drives."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.errors import LogError, UnknownNameError
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.data.motion import STILL_EXTENT_M
from advdiff_sumo.data.nuscenes import ZOE_CENTRE_AHEAD_M, NuScenesReader
from advdiff_sumo.data.scenarionet_log import ScenarioNetReader, map_offset_m, read_record

STEPS = 21
AT = np.arange(STEPS) * 0.1


def _track(kind: str, category: str, xy: np.ndarray, valid: np.ndarray, size: tuple[float, float]) -> Any:
    return {
        "type": kind,
        "state": {
            "position": np.column_stack((xy, np.zeros(STEPS))),
            "heading": np.zeros(STEPS),
            "velocity": np.zeros((STEPS, 2)),
            "valid": valid.astype(float),
            "length": np.full((STEPS, 1), size[0]) * valid[:, None],
            "width": np.full((STEPS, 1), size[1]) * valid[:, None],
        },
        "metadata": {"type": category, "object_id": "x"},
    }


def record(dataset: str = "nuscenes") -> dict[str, Any]:
    """Return a record in which the ego drives east at 10 m/s from (300, 400) in the map."""
    shift = np.array([-300.0, -400.0]) if dataset == "nuscenes" else np.zeros(2)
    always, late = np.ones(STEPS, bool), np.arange(STEPS) >= 10
    ego = np.column_stack((300 + 10 * AT, np.full(STEPS, 400.0))) + shift
    other = np.where(late[:, None], np.column_stack((350 + 5 * AT, np.full(STEPS, 410.0))), 0.0) + shift
    named = dataset == "nuscenes"
    return {
        "id": "drive",
        "length": STEPS,
        "metadata": {"dataset": dataset, "map": "old-town", "sdc_id": "ego", "ts": AT},
        "tracks": {
            "ego": _track("VEHICLE", "vehicle.car" if named else "VEHICLE", ego, always, (1.73, 4.08)),
            "b": _track("VEHICLE", "vehicle.truck" if named else "VEHICLE", other, late, (9.0, 2.5)),
            "cone": _track("TRAFFIC_CONE", "movable_object.x" if named else "CONE", other, late, (1, 1)),
            "never": _track("VEHICLE", "vehicle.car", np.zeros((STEPS, 2)) + shift, ~always, (4, 2)),
        },
        "map_features": {},
        "dynamic_map_states": {},
    }


@pytest.fixture
def write(tmp_path: Path) -> Any:
    def save(value: Any, name: str = "sd_drive.pkl", protocol: int = 4) -> Path:
        path = tmp_path / name
        path.write_bytes(pickle.dumps(value, protocol=protocol))
        return path

    return save


def test_a_nuscenes_record_is_put_back_into_its_map(write: Any) -> None:
    scene = ScenarioNetReader(write(record())).read("sd_drive")
    assert (scene.location, scene.tracks.ids, scene.ego) == ("old-town", ("ego", "b"), 0)
    assert scene.tracks.dt_s == 0.1
    np.testing.assert_allclose(scene.tracks.xy_m[0, 0], [300.0 + ZOE_CENTRE_AHEAD_M, 400.0])
    assert scene.tracks.size_m.tolist() == [[4.084, 1.73], [9.0, 2.5]]
    assert scene.tracks.classes.tolist() == [AgentClass.CAR, AgentClass.TRUCK]
    np.testing.assert_allclose(scene.tracks.speed_mps[0], 10.0)
    np.testing.assert_allclose(scene.tracks.speed_mps[1, 10:], 5.0)
    assert np.isnan(scene.tracks.xy_m[1, :10]).all()


def test_a_lost_offset_is_owned_up_to(write: Any) -> None:
    value = record()
    value["tracks"] = {"ego": value["tracks"]["ego"]}
    assert map_offset_m(value) is None
    assert ScenarioNetReader(write(value)).read("sd_drive").location == ""


def test_a_waymo_record_stays_in_its_frame_and_tells_lorries_by_length(write: Any) -> None:
    scene = ScenarioNetReader(write(record("waymo"))).read("sd_drive")
    assert scene.location == ""
    assert scene.tracks.xy_m[0, 0].tolist() == [300.0, 400.0]
    assert scene.tracks.classes.tolist() == [AgentClass.CAR, AgentClass.TRUCK]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda r: r.pop("tracks"), "has no 'tracks'"),
        (lambda r: r["metadata"].__setitem__("sdc_id", "gone"), "'gone' has no track"),
        (lambda r: r["metadata"].__setitem__("ts", AT**2), "not evenly spaced"),
        (lambda r: r["tracks"]["b"]["state"].pop("heading"), "cannot be used"),
        (lambda r: r["tracks"]["b"]["state"]["heading"].__setitem__(15, np.nan), "not finite"),
    ],
)
def test_damage_is_named(write: Any, damage: Any, said: str) -> None:
    value = record()
    damage(value)
    with pytest.raises(LogError, match=said):
        ScenarioNetReader(write(value)).read("sd_drive")


def test_missing_and_unknown(write: Any, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such record"):
        ScenarioNetReader(tmp_path / "none").names()
    with pytest.raises(UnknownNameError, match="sd_drive"):
        ScenarioNetReader(write(record())).read("sd_drove")
    with pytest.raises(LogError, match="cannot be read"):
        read_record(tmp_path / "none.pkl")
    with pytest.raises(LogError, match="holds no record"):
        read_record(write([1, 2]))


@pytest.mark.data
@pytest.mark.parametrize("name", ["scene-0553", "scene-0796"])
def test_real_records_agree_with_the_tables(adv_data: Path, name: str) -> None:
    tables = NuScenesReader(adv_data / "nuscenes-mini").read(name)
    scene = ScenarioNetReader(adv_data / "scenarionet").read(f"sd_nuscenes_v1.0-mini_{name}")
    assert scene.location == tables.location
    assert set(scene.tracks.ids) == set(tables.tracks.ids)
    order = [scene.tracks.index[key] for key in tables.tracks.ids]
    ours, theirs = tables.tracks, scene.tracks.rows(order)
    assert theirs.classes.tolist() == ours.classes.tolist()
    np.testing.assert_allclose(theirs.size_m, ours.size_m)
    keyframes = slice(0, 5 * ours.steps, 5)
    np.testing.assert_array_equal(theirs.valid[:, keyframes], ours.valid)
    moves = ours.valid & (ours.speed_mps != 0.0) & (theirs.speed_mps[:, keyframes] != 0.0)
    assert moves.sum() > 300
    np.testing.assert_allclose(theirs.xy_m[:, keyframes][moves], ours.xy_m[moves], atol=1e-6)
    np.testing.assert_allclose(np.cos(theirs.yaw_rad[:, keyframes] - ours.yaw_rad)[moves], 1.0, atol=1e-9)
    rest = ours.valid & ~moves  # what stands is stilled on the clock of each
    np.testing.assert_allclose(theirs.xy_m[:, keyframes][rest], ours.xy_m[rest], atol=2 * STILL_EXTENT_M)


@pytest.mark.data
def test_real_waymo_record(adv_data: Path) -> None:
    path = next((adv_data / "scenarionet").glob("sd_training*.pkl"))
    raw, scene = read_record(path), ScenarioNetReader(path).read(path.stem)
    assert scene.tracks.agents == len(raw["tracks"]) == 115
    assert scene.tracks.ids[scene.ego] == raw["metadata"]["sdc_id"]
    moving = np.linalg.norm(np.asarray(raw["tracks"]["1101"]["state"]["velocity"], float), axis=-1)
    assert np.abs(scene.tracks.speed_mps[scene.ego] - moving).max() < 0.5
    assert raw["map_features"]
    assert raw["dynamic_map_states"]
