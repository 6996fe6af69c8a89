"""The shipped lists of seed scenes are what they were, nested, and refused when they were changed."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.experiments.bench.cells import BenchCell, plan_cells
from advdiff_sumo.experiments.bench.defect_score import scene_order
from advdiff_sumo.experiments.bench.scene_list import (
    DEFECTS_LIST,
    JUNCTIONS_LIST,
    RED_LIGHTS_LIST,
    TABLE_LIST,
    TABLE_SEED,
    TUNING_LIST,
    TUNING_SEED,
    SceneList,
    Stratum,
    choose_scenes,
    make_list,
    read_scene_list,
    shipped_list,
    write_scene_list,
)
from advdiff_sumo.sim.sim_options import SceneOptions

DIGESTS = {
    TUNING_LIST: "4bc5a5e4ead4aaa472b56f488c7e7bf51ca03c717ad8968f9e5e7645b5ec2a75",
    TABLE_LIST: "c34b7930804bf5646eeff8e9e2dbaec77b4dfaa45c5988e174ed2d2853219cb5",
    DEFECTS_LIST: "3523276600883a28508ddb2a437f59666a15574f6722c8a2e178a2cf2b9ffcdf",
    RED_LIGHTS_LIST: "922c7caf421e0357cadfa259e0f25164b4aa2e52697edf9cc95c5b24a14edd57",
    JUNCTIONS_LIST: "d677ce15104abc66f5a8427ac8ea26d5ca1c6ffca1ae704fc4213ef6c7728c67",
}


@pytest.fixture
def tuning() -> SceneList:
    return read_scene_list(shipped_list(TUNING_LIST))


@pytest.mark.parametrize("name", sorted(DIGESTS))
def test_the_shipped_lists_are_what_they_were(name: str) -> None:
    assert read_scene_list(shipped_list(name)).sha256 == DIGESTS[name]


def test_the_tables_list_has_300_scenes_of_all_nets_and_none_that_is_tuned_on(tuning: SceneList) -> None:
    table = read_scene_list(shipped_list(TABLE_LIST))
    assert Counter(scene.net for scene in table.scenes) == {
        "downtown": 100,
        "downtown-left": 100,
        "motorway": 100,
    }
    assert not {s.place for s in table.scenes} & {s.place for s in tuning.scenes}


def test_fewer_scenes_are_contained_in_more_and_stratified(tuning: SceneList) -> None:
    few, more = tuning.first(9), tuning.first(30)
    assert more.scenes[:9] == few.scenes
    assert set(few.counts().values()) == {3}
    assert len({few.sha256, more.sha256, tuning.sha256}) == 3


def test_a_list_that_was_changed_is_refused(tuning: SceneList, tmp_path: Path) -> None:
    path = tmp_path / "list.json"
    write_scene_list(path, tuning.first(4))
    assert read_scene_list(path) == tuning.first(4)
    content = json.loads(path.read_text())
    content["scenes"][2]["seed"] = 5
    path.write_text(json.dumps(content))
    with pytest.raises(FileError, match="not what its sha256 says; restore it"):
        read_scene_list(path)


def test_a_list_for_another_net_or_out_of_order_is_refused(tuning: SceneList, tmp_path: Path) -> None:
    path = tmp_path / "list.json"
    other = tuning.model_copy(update={"nets": {"downtown": "0"}})
    write_scene_list(path, other.model_copy(update={"sha256": other.content_digest}))
    with pytest.raises(FileError, match="another net 'downtown'"):
        read_scene_list(path)
    turned = tuning.model_copy(update={"scenes": tuning.scenes[::-1]})
    write_scene_list(path, turned.model_copy(update={"sha256": turned.content_digest}))
    with pytest.raises(FileError, match="out of order; number them from 0"):
        read_scene_list(path)


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "cannot be read"), ("{", "is no JSON"), ("{}", "is no list of seed scenes")],
)
def test_other_files_are_refused(content: str | None, said: str, tmp_path: Path) -> None:
    path = tmp_path / "list.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(FileError, match=said):
        choose_scenes(str(path))


@pytest.mark.parametrize(("asked", "said"), [("0", "above 0"), ("-3", "above 0"), ("301", "has 300")])
def test_numbers_that_make_no_sense_are_refused(asked: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        choose_scenes(asked)


def test_the_shipped_lists_are_what_their_tool_makes(tmp_path: Path) -> None:
    for name, seed, per_net in ((TABLE_LIST, TABLE_SEED, 100), (TUNING_LIST, TUNING_SEED, 20)):
        shipped = read_scene_list(shipped_list(name))
        made = make_list(per_net, seed, shipped.about, scene=shipped.scene, horizon_s=shipped.horizon_s)
        write_scene_list(tmp_path / name, made)
        assert (tmp_path / name).read_bytes() == shipped_list(name).read_bytes()


@pytest.mark.parametrize("name", [DEFECTS_LIST, RED_LIGHTS_LIST, JUNCTIONS_LIST])
def test_the_lists_by_situation_are_what_their_tool_makes(name: str) -> None:
    tool = Path(__file__).parents[3] / "tools" / "make_bench_scenes.py"
    done = subprocess.run(
        [sys.executable, tool, "--check", "--only", name], capture_output=True, text=True, check=False
    )
    assert (done.returncode, DIGESTS[name] in done.stdout) == (0, True), done.stdout + done.stderr


def test_strata_take_turns_with_a_seed_each() -> None:
    dense, turning = SceneOptions(density_per_km=20.0), SceneOptions(situation="turning")
    strata = {
        "dense": Stratum(nets=("downtown", "motorway"), scene=dense),
        "turning": Stratum(nets=("downtown",), scene=turning),
    }
    scenes = make_list(2, 50, "a test", strata=strata)
    assert scenes.counts() == {
        ("downtown", 50, "dense"): 2,
        ("motorway", 50, "dense"): 2,
        ("downtown", 51, "turning"): 2,
    }
    assert [scene.place[::3] for scene in scenes.first(4).scenes] == [
        *(("downtown", 0), ("motorway", 0), ("downtown", 0), ("downtown", 1)),
    ]
    cells = plan_cells([BenchCell("sumo", "IDM", "sumo")], scenes, 10.0)
    assert [(cell.net, cell.scene, cell.episodes) for cell in cells.plan.cells] == [
        *(("downtown", dense, 2), ("motorway", dense, 2), ("downtown", turning, 2)),
    ]
    assert sorted(scene_order(cells).values()) == list(range(6))


def test_a_scene_of_an_unknown_stratum_is_refused(tmp_path: Path) -> None:
    strata = {"dense": Stratum(nets=("downtown",), scene=SceneOptions())}
    scenes = make_list(2, 50, "a test", strata=strata).model_copy(update={"strata": {}})
    path = tmp_path / "list.json"
    write_scene_list(path, scenes.model_copy(update={"sha256": scenes.content_digest}))
    with pytest.raises(FileError, match="has no stratum 'dense'; name one of its strata"):
        read_scene_list(path)


def test_the_first_scene_is_the_one_of_a_run_with_that_seed() -> None:
    first = read_scene_list(shipped_list(TUNING_LIST)).scenes[0]
    assert first.place == ("downtown", TUNING_SEED, "", 0)
