"""Which reader a file or folder gets, and what is said of those that are no log."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import LogError
from advdiff_sumo.data import (
    Argoverse2Reader,
    CommonRoadReader,
    NuScenesReader,
    ScenarioNetReader,
    open_log,
)

KINDS = (
    "nuScenes",
    "v1.0-*/scene.json",
    "ScenarioNet",
    "sd_*.pkl",
    "Waymo",
    "Argoverse 2",
    "CommonRoad",
    "runs",
)


@pytest.mark.parametrize(
    ("file", "reader"),
    [
        ("v1.0-mini/scene.json", NuScenesReader),
        ("scene.json", NuScenesReader),
        ("nuscenes_0/sd_a.pkl", ScenarioNetReader),
        ("town/scenario_a.parquet", Argoverse2Reader),
        ("a.xml", CommonRoadReader),
    ],
)
def test_a_folder_is_known_by_what_is_in_it(tmp_path: Path, file: str, reader: type) -> None:
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text("<commonRoad/>")
    assert isinstance(open_log(tmp_path), reader)


@pytest.mark.parametrize(
    ("name", "content", "advice"),
    [
        ("notes.txt", b"none", "give one of these"),
        ("dataset_summary.pkl", b"N.", "give one of these"),
        ("street.net.xml", b"<net/>", "give one of these"),
        ("training.tfrecord-00000-of-01000", b"", "with ScenarioNet first"),
        ("2021.05.12.db", b"", "with ScenarioNet first"),
        ("boston-seaport.json", b"{}", "a map is no log"),
    ],
)
def test_what_is_no_log_is_told_which_are_known_and_what_was_looked_for(
    tmp_path: Path, name: str, content: bytes, advice: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError) as raised:
        open_log(tmp_path)
    said = str(raised.value)
    assert said.startswith(f"{tmp_path}: holds no driving log of a known kind: ")
    assert not [word for word in (*KINDS, advice) if word not in said]


def test_one_file_that_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "street.net.xml").write_text("<net/>")
    with pytest.raises(LogError, match=r"street\.net\.xml: is no driving log of a known kind: .*CommonRoad"):
        open_log(tmp_path / "street.net.xml")
    with pytest.raises(
        LogError, match=r"none: no such log; logs that are known are those of nuScenes .*Argoverse 2"
    ):
        open_log(tmp_path / "none")


def test_nets_beside_scenarios_are_no_scenarios(tmp_path: Path) -> None:
    """The net of a scenario is called like it, and took its place."""
    (tmp_path / "ZAM_T-1.xml").write_text('<?xml version="1.0"?><commonRoad/>')
    for name in ("ZAM_T-1.net.xml", "ZAM_T-1.poly.xml"):
        (tmp_path / name).write_text("<net/>")
    assert open_log(tmp_path).names() == ["ZAM_T-1"]
    (tmp_path / "ZAM_T-2.xml.gz").write_bytes(gzip.compress(b"<commonRoad/>")[:12])
    reader = open_log(tmp_path)
    assert reader.names() == ["ZAM_T-1", "ZAM_T-2"]  # its reader says what is wrong with it


def test_scenes_of_one_name_in_two_folders_are_both_there(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "sd_drive.pkl").write_bytes(b"")
    (tmp_path / "b" / "sd_other.pkl").write_bytes(b"")
    assert open_log(tmp_path).names() == ["a-sd_drive", "b-sd_drive", "sd_other"]
