"""Seed scenes of a bench out of real driving logs, and the licence that a bench is run with."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.core.errors import ConfigError, LogError, SceneError
from advdiff_sumo.experiments.bench.adversarial import plan_adversarial
from advdiff_sumo.experiments.bench.bench_config import BenchName, Folder, Request
from advdiff_sumo.experiments.bench.bench_rows import POLICY_ROWS, with_licence
from advdiff_sumo.experiments.bench.cells import BenchCell, plan_cells
from advdiff_sumo.experiments.bench.defect_cells import plan_defects
from advdiff_sumo.experiments.bench.reporter import Silent
from advdiff_sumo.experiments.bench.requested_scenes import bench_scenes, is_log
from advdiff_sumo.experiments.bench.scene_list import TABLE_LIST, choose_scenes
from advdiff_sumo.traffic.licence import LicenceName
from tests.sim.records_made import record, write


@pytest.mark.data
def test_a_drive_gives_a_scene_a_second_on_the_net_of_its_own_map(adv_data: Path, tmp_path: Path) -> None:
    log = adv_data / "commonroad" / "USA_Lanker-1_3_T-1.xml.gz"
    scenes = bench_scenes(str(log), TABLE_LIST, tmp_path)
    (net,) = scenes.nets
    assert Path(net).is_file()
    assert Path(net).parent == tmp_path / "nets"
    assert (scenes.log, scenes.scene.stride_s, scenes.horizon_s) == (str(log), 1.0, 6.0)
    assert [scene.number for scene in scenes.scenes] == list(range(len(scenes.scenes)))
    assert bench_scenes(str(log), TABLE_LIST, tmp_path) == scenes  # the net is made once
    cells = plan_cells([BenchCell("sumo", "IDM", "sumo")], scenes, 2.0)
    assert len(cells.plan.jobs) == len(scenes.scenes) > 0
    assert {cells.plan.options(job).scenes for job in cells.plan.jobs} == {str(log)}


@pytest.mark.data
def test_records_of_which_no_episode_can_begin_get_a_sentence(adv_data: Path, tmp_path: Path) -> None:
    records = adv_data / "scenarionet"
    nuscenes, waymo = records / "sd_nuscenes_v1.0-mini_scene-0553.pkl", next(records.glob("sd_training*.pkl"))
    with pytest.raises(SceneError, match="ego is never faster than 1 m/s"):  # it waits all the time
        bench_scenes(str(nuscenes), TABLE_LIST, tmp_path / "a")
    with pytest.raises(SceneError, match="its ego never drives along a lane"):
        bench_scenes(str(waymo), TABLE_LIST, tmp_path / "b")


@pytest.mark.data
def test_a_record_of_nuscenes_gives_scenes_on_the_net_of_its_own_map(adv_data: Path, tmp_path: Path) -> None:
    path = adv_data / "scenarionet" / "sd_nuscenes_v1.0-mini_scene-0796.pkl"
    scenes = bench_scenes(str(path), TABLE_LIST, tmp_path)
    assert [Path(net).name for net in scenes.nets] == [f"{path.stem}.net.xml"]
    assert len(scenes.scenes) >= 3


def test_drives_without_a_net_are_named_with_the_reason(tmp_path: Path) -> None:
    write(tmp_path / "logs" / "sd_there.pkl", record((100.0, 0.0), told=True))
    write(tmp_path / "logs" / "sd_lost.pkl", record(told=True) | {"map_features": {}})
    scenes = bench_scenes(str(tmp_path / "logs"), TABLE_LIST, tmp_path)
    assert len(scenes.scenes) > 0
    assert "without sd_lost: its map cannot be converted: " in scenes.about
    (tmp_path / "logs" / "sd_there.pkl").unlink()
    with pytest.raises(SceneError, match=r"logs: none of its drives .*without sd_lost: its map cannot be"):
        bench_scenes(str(tmp_path / "logs"), TABLE_LIST, tmp_path)


@pytest.mark.data
def test_a_log_is_only_opened_before_the_bench_begins(adv_data: Path, tmp_path: Path) -> None:
    assert bench_scenes(str(adv_data / "nuscenes-mini"), TABLE_LIST, None).scenes == ()
    with pytest.raises(LogError, match="holds no driving log"):
        bench_scenes(str(tmp_path), TABLE_LIST, None)


def test_numbers_and_lists_are_no_logs(tmp_path: Path) -> None:
    (tmp_path / "list.json").write_text("{}")
    assert [is_log(x) for x in ("12", str(tmp_path / "list.json"), "nowhere", str(tmp_path))] == [
        False,
        False,
        False,
        True,
    ]
    assert bench_scenes("3", TABLE_LIST, None) == choose_scenes("3")
    assert "log" not in choose_scenes("3").model_dump(mode="json")  # lists keep their digests


@pytest.mark.parametrize("licence", ["lawful", "careless", "reckless"])
def test_a_licence_holds_for_all_that_attack_and_for_nobody_else(licence: str, tmp_path: Path) -> None:
    request = Request(
        bench="adversarial",
        scenes="3",
        policies=("sumo", "unguided", "advsim"),
        targets=("IDM",),
        licence=licence,
    )
    cells = {
        cell.row: cell.background_options
        for cell in plan_adversarial(Folder(tmp_path, request), Silent()).cells
    }
    assert cells == {
        "sumo": {},
        "unguided": {"guide": "none", "licence": licence},
        "advsim": {"licence": licence},
    }


def test_without_a_licence_the_papers_tables_are_reckless_and_defects_meet_the_default(
    tmp_path: Path,
) -> None:
    plain = Request(bench="adversarial", scenes="3")
    assert with_licence(POLICY_ROWS["diffusion"].options, plain) == {"licence": "reckless"}
    request = Request(bench="defects", scenes="3", policies=("advsim",), defects=("late",))
    cells = plan_defects(Folder(tmp_path, request), Silent()).cells
    assert {str(cell.background_options) for cell in cells} == {"{}"}
    reckless = request.model_copy(update={"licence": "reckless"})
    cells = plan_defects(Folder(tmp_path, reckless), Silent()).cells
    assert {str(cell.background_options) for cell in cells} == {"{'licence': 'reckless'}"}


@pytest.mark.parametrize(
    ("bench", "licence", "means"),
    [
        ("adversarial", None, {"licence": "reckless"}),
        ("adversarial", "careless", {"licence": "careless"}),
        ("defects", None, {}),
        ("defects", "careless", {"licence": "careless"}),
    ],
)
def test_scripted_attackers_have_the_licence_of_the_others(
    bench: BenchName, licence: LicenceName | None, means: dict[str, str], tmp_path: Path
) -> None:
    policies = ("scripted", "advsim")
    request = Request(bench=bench, scenes="3", policies=policies, targets=("IDM",), licence=licence)
    plan = plan_defects if bench == "defects" else plan_adversarial
    cells = plan(Folder(tmp_path, request), Silent()).cells
    assert {cell.background for cell in cells} == set(policies)
    assert all(cell.background_options == means for cell in cells)


def test_an_unknown_licence_is_refused() -> None:
    with pytest.raises(ConfigError, match="licence"):
        Request.parse({"bench": "adversarial", "licence": "legal"}, "bench adversarial")
