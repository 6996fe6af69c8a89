"""The folder of a sweep: incomplete files do not count, damage is noticed, other sweeps are refused."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.sweep.job_plan import Job, SweepPlan
from advdiff_sumo.sweep.spec import SweepSpec
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.sweep_files import read_checked, write_checked
from advdiff_sumo.sweep.sweep_runner import open_store
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import Failed
from tests.hang_guard import HANG_S

PLAN = SweepPlan(
    SweepSpec.of({"grid": {"targets": ["IDM"], "backgrounds": ["sumo"]}}, "x"), (), (), {}, (), 0
)
PART = StoredEpisode({}, Failed("timeout", "not finished after 3 s", "thinking", 1)).to_bytes()


def test_a_written_episode_is_read_again(tmp_path: Path) -> None:
    store = open_store(tmp_path / "s", PLAN, 1, resume=False)
    store.write("abcdef", PART)
    part = store.read("abcdef")
    assert part is not None
    assert part.failed == Failed("timeout", "not finished after 3 s", "thinking", 1)
    assert store.has("abcdef")
    assert not store.has("abcdee")
    assert not list((tmp_path / "s").rglob("*.aside"))


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "head"])
def test_a_damaged_episode_is_missing(tmp_path: Path, damage: str) -> None:
    store = open_store(tmp_path / "s", PLAN, 1, resume=False)
    store.write("abcdef", PART)
    (path,) = (path for path in (tmp_path / "s" / "episodes").rglob("*") if path.is_file())
    content = bytearray(path.read_bytes())
    if damage == "flipped":
        content[-5] ^= 1
    if damage == "head":
        content[20] ^= 1
    path.write_bytes(bytes(content[:-1] if damage == "cut" else b"" if damage == "empty" else content))
    assert store.read("abcdef") is None
    assert not store.has("abcdef")


def test_damaged_scenes_are_missing(tmp_path: Path) -> None:
    store = open_store(tmp_path / "s", PLAN, 1, resume=False)
    store.write_scenes("batch", (b"one", b"two"), 2)
    assert Store(store.path).read_scenes("batch") == (b"one", b"two")
    path = store.path / "scenes" / "batch"
    path.write_bytes(path.read_bytes()[:-1])
    assert Store(store.path).read_scenes("batch") is None
    assert not Store(store.path).has_scenes("batch", 1)


def test_a_log_has_fewer_scenes_than_wanted_only_if_as_many_were_wanted(tmp_path: Path) -> None:
    store = open_store(tmp_path / "s", PLAN, 1, resume=False)
    store.write_scenes("batch", (b"one", b"two"), 5)
    again = Store(store.path)
    assert [again.has_scenes("batch", wanted) for wanted in (2, 5, 6)] == [True, True, False]
    assert again.read_scenes("batch") == (b"one", b"two")


def test_a_folder_in_use_is_refused(tmp_path: Path) -> None:
    open_store(tmp_path / "s", PLAN, 1, resume=False)
    with pytest.raises(FileError, match="already holds a sweep; go on with --resume"):
        open_store(tmp_path / "s", PLAN, 1, resume=False)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    with pytest.raises(FileError, match="no empty folder"):
        open_store(tmp_path / "other", PLAN, 1, resume=False)
    with pytest.raises(FileError, match="holds no sweep"):
        open_store(tmp_path / "other", PLAN, 1, resume=True)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.toml").touch()
    with pytest.raises(FileError, match="holds a run, no sweep; look at it with advdiff-sumo report"):
        open_store(tmp_path / "run", PLAN, 1, resume=True)
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["file"]


def test_another_sweep_is_refused(tmp_path: Path) -> None:
    open_store(tmp_path / "s", PLAN, 1, resume=False)
    other = replace(PLAN, spec=PLAN.spec.model_copy(update={"horizon_s": 5.0}))
    with pytest.raises(ConfigError, match="belongs to another sweep: its horizon_s differ"):
        open_store(tmp_path / "s", other, 1, resume=True)
    assert Store.open(tmp_path / "s").spec() == PLAN.spec


def test_a_sweep_whose_net_has_changed_is_refused(tmp_path: Path) -> None:
    open_store(tmp_path / "s", PLAN, 1, resume=False)
    other = replace(PLAN, jobs=(Job("another key", 0, 0, 0, "batch", 0, "scene"),))
    with pytest.raises(ConfigError, match="a net, demand or log is not what it was"):
        open_store(tmp_path / "s", other, 1, resume=True)


def test_disk_space_is_reserved_and_released(tmp_path: Path) -> None:
    store = open_store(tmp_path / "s", PLAN, 2, resume=False)
    assert (store.path / "ballast").stat().st_size == 3 * (4 << 20)
    store.end()
    assert sorted(path.name for path in store.path.iterdir()) == ["episodes", "sweep.toml"]


def test_a_full_disk_at_the_start_leaves_nothing_behind(tmp_path: Path) -> None:
    """Else the same command would be refused because of a folder that cannot be resumed."""
    script = (
        "import resource, sys; from pathlib import Path\n"
        "from advdiff_sumo.core.errors import FileError\n"
        "from advdiff_sumo.sweep.sweep_store import Store\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try: Store.create(Path(sys.argv[1]), {}, 5000)\n"
        "except FileError as error: print(error)\n"
    )
    path = tmp_path / "s"
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True, timeout=HANG_S
    )
    assert done.stdout.strip() == f"{path}: the disk is full; free some space, or choose another --out"
    assert not path.exists()


def test_a_full_disk_keeps_the_old_file_and_leaves_no_other(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_checked(path, b"old")
    script = (
        "import resource, sys; from pathlib import Path\n"
        "from advdiff_sumo.sweep.sweep_files import DiskFullError, write_checked\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try: write_checked(Path(sys.argv[1]), bytes(5000))\n"
        "except DiskFullError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True, timeout=HANG_S
    )
    assert done.stdout.strip() == f"{path}: the disk is full; free some space and go on with --resume"
    assert read_checked(path) == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
