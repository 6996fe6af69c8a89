"""The shipped lists of seed scenes are what they were, nested, and refused when they were changed."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.experiments.bench.scene_list import (
    TABLE_LIST,
    TUNING_LIST,
    SceneList,
    choose_scenes,
    make_list,
    read_scene_list,
    shipped_list,
    write_scene_list,
)
from advdiff_sumo.sim.options import SceneOptions

DIGESTS = {
    TUNING_LIST: "0b49853a16500375752b6d89c54f52ede7e04afb2c6f87cbe1d09828643858bd",
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


def test_the_same_arguments_give_the_same_bytes(tmp_path: Path) -> None:
    scene = SceneOptions(warmup_s=8.0, scenes_per_warmup=2, spacing_s=2.0, min_neighbours=1)
    for name in ("a", "b"):
        write_scene_list(tmp_path / name, make_list(2, 5, "a test", ("motorway",), scene))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    found = read_scene_list(tmp_path / "a")
    assert [scene.place for scene in found.scenes] == [("motorway", 5, 0), ("motorway", 5, 1)]
    assert found.scenes[0].vehicles > 1
