"""Export of episodes in other formats, and a run that starts from an exported file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from advdiff_sumo.export import import_scene
from tests.e2e.commands import TINY, Outcome, advdiff, everything
from tests.e2e.conftest import PLANNERS, sentence

FILES = {
    "openscenario": ("first-0001.xosc", "first-0001.xodr"),
    "commonroad": ("first-0001.cr.xml",),
    "scenarionet": ("sd_advdiff-sumo_1_first-0001.pkl",),
    "fcd": ("first-0001.fcd.xml", "first-0001.add.xml", "first-0001.sumocfg", "first-0001.net.xml"),
    "csv": ("first-0001.csv",),
}


@pytest.fixture(scope="session")
def exported(downtown_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the second episode of a run in every format."""
    folder = tmp_path_factory.mktemp("exported")
    words = ("--episode", 1, "--format", "all", "--out", folder)
    done = advdiff("export", downtown_run, *words, cwd=folder)
    assert (done.code, done.err) == (0, "")
    assert done.out.split() == [str(folder / name) for names in FILES.values() for name in names]
    return folder


@pytest.mark.parametrize("name", FILES)
def test_states_come_back(name: str, exported: Path, downtown_run: Path) -> None:
    read = import_scene(exported / FILES[name][0])
    table = pq.read_table(downtown_run / "states.parquet", filters=[("episode", "==", 1)]).to_pylist()
    assert int(read.tracks.valid.sum()) == len(table) > 100
    for row in table:
        at = (read.tracks.index[row["agent"]], row["step"])
        assert read.tracks.xy_m[at] == pytest.approx((row["x_m"], row["y_m"]), abs=0.01)
        assert read.tracks.classes[at[0]] == ("car", "truck", "bus", "motorcycle", "bicycle").index(
            row["class"]
        )
        assert (at[0] == read.target) == row["is_target"]


def test_same_bytes_from_another_process(exported: Path, downtown_run: Path, tmp_path: Path) -> None:
    words = (
        "--episode",
        1,
        "-f",
        "scenarionet",
        "-f",
        "commonroad",
        "-f",
        "fcd",
        "-f",
        "csv",
        "--out",
        tmp_path / "x",
    )
    assert advdiff("export", downtown_run, *words, cwd=tmp_path, hash_seed=1).code == 0
    again = everything(tmp_path / "x")
    assert again == {name: (exported / name).read_bytes() for name in again}
    assert len(again) == 7


def test_beside_the_run_by_default(downtown_run: Path, here: Callable[..., Outcome], workplace: Path) -> None:
    (workplace / "copy").mkdir()
    for path in downtown_run.iterdir():
        if path.is_file():
            (workplace / "copy" / path.name).write_bytes(path.read_bytes())
    done = here("export", "copy", "--episode", 0, "-f", "csv")
    assert (done.code, done.out.split()) == (0, ["copy/exports/copy-0000.csv"])


@pytest.fixture(scope="module")
def failed_at_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run whose only episode failed at its first plan."""
    folder = tmp_path_factory.mktemp("failed")
    (folder / "planners.py").write_text(PLANNERS, encoding="utf-8")
    words = ("--target", "planners:Raises", "--episodes", 1, "--out", folder / "run", *TINY)
    assert advdiff("run", *words, cwd=folder).code == 1
    return folder / "run"


def test_an_episode_of_one_instant_is_left_out_of_openscenario_alone(
    failed_at_once: Path, tmp_path: Path
) -> None:
    words = ("export", failed_at_once, "--episode", 0, "--out", tmp_path / "x", "-f")
    said = "error: run-0000 ended at its first instant, and the format 'openscenario' holds motion only"
    single = advdiff(*words, "openscenario", cwd=tmp_path)
    assert sentence(single).startswith(said)
    assert list((tmp_path / "x").iterdir()) == []
    done = advdiff(*words, "all", cwd=tmp_path)
    assert (done.code, done.err.startswith(said)) == (2, True)
    others = [
        name.replace("first-0001", "run-0000")
        for key in FILES
        if key != "openscenario"
        for name in FILES[key]
    ]
    assert done.out.split() == [str(tmp_path / "x" / name) for name in others]
    read = import_scene(tmp_path / "x" / "run-0000.csv")
    assert read.tracks.steps == 1


def test_refusals(downtown_run: Path, here: Callable[..., Outcome], workplace: Path) -> None:
    (workplace / "file").write_text("in the way")
    cases = {
        ("export", downtown_run, "-f", "csv"): "say which episode with --episode",
        ("export", downtown_run, "--episode", 1): "known are: openscenario, commonroad",
        ("export", downtown_run, "--episode", 9, "-f", "csv"): "has no episode 9; it has 0 to 1",
        ("export", downtown_run, "--episode", 1, "-f", "opendrive"): "unknown format 'opendrive'",
        ("export", "nowhere", "--episode", 1, "-f", "csv"): "give the folder of a finished run",
        ("export", downtown_run, "--episode", 1, "-f", "csv", "--out", "file/x"): "choose another --out",
    }
    before = everything(workplace)
    for words, said in cases.items():
        assert said in sentence(here(*words))
    assert everything(workplace) == before
