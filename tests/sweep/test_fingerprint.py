"""Keys of seed scenes differ between the logs that they are made from."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.sweep.fingerprint import cell_digest, files_of, source_digest


def digest_of(root: Path) -> str:
    return source_digest(RunOptions(net="downtown", scenes=str(root)), None)


@pytest.mark.parametrize("name", ["a.xml", "town/scenario_a.parquet", "states.parquet", "sd_a.pkl"])
def test_logs_of_every_kind_count(tmp_path: Path, name: str) -> None:
    """In an earlier version, Argoverse 2 and CommonRoad did not count: two folders had the same key."""
    digests = set()
    for folder, content in (("one", "<commonRoad/>"), ("other", "<commonRoad> </commonRoad>")):
        path = tmp_path / folder / name
        path.parent.mkdir(parents=True)
        path.write_text(content)
        digests.add(digest_of(tmp_path / folder))
    assert len(digests) == 2


def test_files_of_a_run_in_the_folder_of_a_log_do_not_count(tmp_path: Path) -> None:
    (tmp_path / "log" / "runs" / "a").mkdir(parents=True)
    (tmp_path / "log" / "a.xml").write_text("<commonRoad/>")
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / "a.xml").write_text("<commonRoad/>")
    for name in ("runs/a/states.parquet", "runs/a/run.toml", "a.net.xml"):
        (tmp_path / "log" / name).write_text("<net/>")
    assert digest_of(tmp_path / "log") == digest_of(copy)


def test_a_net_that_has_changed_has_another_key_in_the_same_process(tmp_path: Path, networks: Path) -> None:
    net = tmp_path / "a.net.xml"
    text = (networks / "downtown.net.xml").read_text(encoding="utf-8")
    digests = set[str]()
    for content in (text, text + "<!-- later -->"):
        net.write_text(content, encoding="utf-8")
        digests.add(source_digest(RunOptions(net=str(net)), None))
    assert len(digests) == 2


def test_files_named_in_options_count_by_content(tmp_path: Path) -> None:
    file = tmp_path / "seen.safetensors"
    file.write_bytes(b"one")
    named = RunOptions(background="scripted", background_options={"reward": str(file), "attack": "any"})
    before, plain = cell_digest(named, "source"), cell_digest(RunOptions(), "source")
    assert files_of(named.background_options) == (file,)
    assert files_of({"reward": "x" * 5000, "seed": 3}) == ()
    (tmp_path / "training").mkdir()
    assert files_of({"weights": str(tmp_path / "training")}) == ()
    (tmp_path / "training" / "weights.safetensors").write_bytes(b"networks")
    assert files_of({"weights": str(tmp_path / "training")}) == (
        tmp_path / "training" / "weights.safetensors",
    )
    file.write_bytes(b"other")
    assert cell_digest(named, "source") != before
    assert cell_digest(RunOptions(), "source") == plain
