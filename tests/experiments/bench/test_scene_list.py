"""The shipped lists of seed scenes are what they were, nested, and refused when they were changed."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.experiments.bench.scene_list import (
    DEFECTS_LIST,
    DEFECTS_SEED,
    TABLE_LIST,
    TABLE_SEED,
    TUNING_LIST,
    TUNING_SEED,
    SceneList,
    choose_scenes,
    make_list,
    read_scene_list,
    shipped_list,
    write_scene_list,
)

DIGESTS = {
    TUNING_LIST: "4bc5a5e4ead4aaa472b56f488c7e7bf51ca03c717ad8968f9e5e7645b5ec2a75",
    TABLE_LIST: "c34b7930804bf5646eeff8e9e2dbaec77b4dfaa45c5988e174ed2d2853219cb5",
    DEFECTS_LIST: "042d9230b3737a38dd0c8b8e57e60762e2cb509dcb509199b1260d523ec33071",
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
    lists = ((TABLE_LIST, TABLE_SEED, 100), (TUNING_LIST, TUNING_SEED, 20), (DEFECTS_LIST, DEFECTS_SEED, 100))
    for name, seed, per_net in lists:
        shipped = read_scene_list(shipped_list(name))
        made = make_list(per_net, seed, shipped.about, scene=shipped.scene, horizon_s=shipped.horizon_s)
        write_scene_list(tmp_path / name, made)
        assert (tmp_path / name).read_bytes() == shipped_list(name).read_bytes()


def test_the_first_scene_is_the_one_of_a_run_with_that_seed() -> None:
    first = read_scene_list(shipped_list(TUNING_LIST)).scenes[0]
    assert first.place == ("downtown", TUNING_SEED, 0)
