"""After Ctrl-C or a kill in the middle of a run, all finished episodes are kept."""

from __future__ import annotations

import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import advdiff_sumo as ads
from advdiff_sumo.cli.interruption import KEPT
from advdiff_sumo.core.errors import INTERRUPTION
from advdiff_sumo.sim.run_store import TABLES
from tests.e2e.commands import TINY, advdiff, begin, bytes_of
from tests.e2e.conftest import PLANNERS
from tests.hang_guard import HANG_S

EPISODES = 4
RUN = (
    *("run", "--net", "grid.net.xml", "--target", "our_planners:Patient", "--background", "replay"),
    *("--episodes", EPISODES, *TINY, "--out", "run"),
)

ENDLESS = """
import time
from pathlib import Path

from advdiff_sumo.planners.lane_graph import LaneGraphPlanner
from advdiff_sumo.traffic.sumo_traffic import SumoTraffic


class Endless(LaneGraphPlanner):
    def start(self, road, scene, rng):
        Path("began").touch()
        time.sleep(1000.0)


class Holds(Endless):
    def start(self, road, scene, rng):
        kind = Endless if Path("hold").exists() else LaneGraphPlanner
        return kind.start(self, road, scene, rng)


class EndlessTraffic(SumoTraffic):
    def start(self, road, scene, log, rng):
        Endless.start(self, road, scene, rng)
"""


@pytest.fixture(scope="module")
def undisturbed(grid: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an uninterrupted run to compare with."""
    folder = _place(grid, tmp_path_factory.mktemp("undisturbed"))
    done = advdiff(*RUN, cwd=folder)
    assert done.code == 0, done.err
    return folder / "run"


@pytest.fixture
def waiting(grid: Path, tmp_path: Path) -> Iterator[tuple[Path, subprocess.Popen[str]]]:
    """Yield the working folder and the process of a run that is in its third episode of four."""
    folder = _place(grid, tmp_path)
    (folder / "hold").touch()
    process = begin(*RUN, cwd=folder, hash_seed=2)
    until = time.monotonic() + HANG_S
    while len(list((folder / "run" / "parts").glob("episodes/00/??????"))) < 2:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.02)
    time.sleep(0.2)  # into the third episode
    yield folder, process
    process.kill()
    process.communicate()


def test_ctrl_c_keeps_what_has_finished(
    waiting: tuple[Path, subprocess.Popen[str]], undisturbed: Path
) -> None:
    folder, process = waiting
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=HANG_S)
    assert process.returncode == 130
    assert said.splitlines() == [f"{KEPT}; go on with advdiff-sumo run --resume --out run"]
    whole = pq.read_table(undisturbed / "episodes.parquet")
    assert pq.read_table(folder / "run" / "episodes.parquet").equals(whole.slice(0, 2))
    for table in TABLES:
        pq.read_table(folder / "run" / f"{table}.parquet")
    assert (folder / "run" / "report.html").stat().st_size > 0
    _resume(folder, undisturbed)


@pytest.mark.slow
def test_a_run_that_another_process_continues_is_refused_until_that_ends(
    waiting: tuple[Path, subprocess.Popen[str]], undisturbed: Path
) -> None:
    folder, process = waiting
    second = advdiff("run", "--resume", "--out", "run", cwd=folder)
    assert second.code == 2
    assert second.err == (
        "error: run: another process is writing into it; wait for its end, or choose a new --out\n"
    )
    (folder / "hold").unlink()
    _, said = process.communicate(timeout=HANG_S)
    assert process.returncode == 0, said
    assert bytes_of(folder / "run") == bytes_of(undisturbed)
    again = advdiff("run", "--resume", "--out", "run", cwd=folder)
    assert again.code == 0, again.err
    assert bytes_of(folder / "run") == bytes_of(undisturbed)


@pytest.mark.slow
def test_sigterm_ends_a_run_in_the_same_way_as_ctrl_c(
    waiting: tuple[Path, subprocess.Popen[str]], undisturbed: Path
) -> None:
    folder, process = waiting
    process.terminate()
    _, said = process.communicate(timeout=HANG_S)
    assert (process.returncode, said.splitlines()) == (
        130,
        [f"{KEPT}; go on with advdiff-sumo run --resume --out run"],
    )
    assert pq.read_table(folder / "run" / "episodes.parquet").num_rows == 2


def test_ctrl_c_while_the_package_is_imported(grid: Path, tmp_path: Path) -> None:
    running = begin("run", "--net", grid, "--out", "out", cwd=tmp_path)
    maps = Path(f"/proc/{running.pid}/maps")
    until = time.monotonic() + HANG_S
    while "numpy" not in maps.read_text():
        assert time.monotonic() < until
        time.sleep(0.01)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=HANG_S)
    assert running.returncode == 130
    assert said.splitlines() == [INTERRUPTION]


def test_ctrl_c_while_a_text_is_executed(grid: Path, tmp_path: Path) -> None:
    """Dataclasses execute texts during imports; Python then remembers the exception although it is caught."""
    (tmp_path / "impatient.py").write_text("exec('raise KeyboardInterrupt')\n")
    running = begin("run", "--net", grid, "--target", "impatient:Planner", "--out", "out", cwd=tmp_path)
    _, said = running.communicate(timeout=HANG_S)
    assert (running.returncode, said.splitlines()) == (130, [INTERRUPTION])


def test_ctrl_c_before_anything_has_finished(grid: Path, tmp_path: Path) -> None:
    folder = _place(grid, tmp_path)
    (folder / "endless.py").write_text(ENDLESS)
    words = ("--target", "endless:Endless", "--background", "replay", *TINY, "--out", "new/run")
    running = begin("run", "--net", "grid.net.xml", *words, cwd=folder)
    said = _interrupted_while_it_plans(running, folder)
    assert running.returncode == 130
    assert said.splitlines() == ["interrupted before anything had finished; no folder is left"]
    assert not (folder / "new").exists()


@pytest.mark.parametrize(
    ("check", "by"),
    [
        (("check-planner", "endless:Endless"), signal.SIGTERM),
        (("check-policy", "endless:EndlessTraffic"), signal.SIGINT),
    ],
)
def test_sigterm_in_a_check_leaves_no_folder(
    grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, check: tuple[str, str], by: signal.Signals
) -> None:
    folder = _place(grid, tmp_path)
    (folder / "endless.py").write_text(ENDLESS)
    words = ("--net", "grid.net.xml", "--episodes", "1", "--horizon", "2")
    _leaves_no_folder((*check, *words), folder, by, monkeypatch)


def test_sigterm_in_a_replay_leaves_no_folder(
    grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = _place(grid, tmp_path)
    (folder / "endless.py").write_text(ENDLESS)
    words = ("--net", "grid.net.xml", "--target", "endless:Holds", "--episodes", 1, *TINY, "--no-report")
    assert advdiff("run", *words, "--out", "run", cwd=folder).code == 0
    (folder / "hold").touch()
    _leaves_no_folder(("replay", "0", "--run", "run"), folder, signal.SIGTERM, monkeypatch)
    assert not (folder / "runs").exists()


def _leaves_no_folder(
    command: tuple[str, ...], folder: Path, by: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Check that *command*, interrupted while it plans, ends as by Ctrl-C and leaves no temporary folder."""
    with (
        tempfile.TemporaryDirectory() as temporary
    ):  # the path of the tests' temporary folder is too long for sockets
        monkeypatch.setenv("TMPDIR", temporary)
        running = begin(*command, cwd=folder)
        _interrupted_while_it_plans(running, folder, by)
        assert running.returncode == 130
        assert not list(Path(temporary).glob("advdiff-*"))


def _interrupted_while_it_plans(
    running: subprocess.Popen[str], folder: Path, by: signal.Signals = signal.SIGINT
) -> str:
    """Interrupt *running* when ``Endless`` plans in *folder*, and return its output."""
    until = time.monotonic() + HANG_S
    while not (folder / "began").exists():
        assert running.poll() is None, running.communicate()
        assert time.monotonic() < until
        time.sleep(0.02)
    running.send_signal(by)
    _, said = running.communicate(timeout=HANG_S)
    return said


@pytest.mark.slow
def test_a_killed_run_can_be_resumed(waiting: tuple[Path, subprocess.Popen[str]], undisturbed: Path) -> None:
    folder, process = waiting
    process.kill()
    process.communicate(timeout=HANG_S)
    assert process.returncode == -signal.SIGKILL
    assert not (folder / "run" / "episodes.parquet").exists()
    _reads_two_episodes(folder)
    _resume(folder, undisturbed)


def _reads_two_episodes(folder: Path) -> None:
    """Check that the two finished episodes of the run can be judged and reported."""
    judged = advdiff("verdict", "run", "--workers", 1, cwd=folder)
    assert (judged.code, judged.out.splitlines()[0]) == (
        0,
        "2 episodes, 0 collisions of the target: 0 valid failures",
    )
    assert advdiff("report", "run", cwd=folder).code == 0
    assert len(ads.load(folder / "run").episodes) == 2


def _resume(folder: Path, undisturbed: Path) -> None:
    (folder / "hold").unlink()
    done = advdiff("run", "--resume", "--out", "run", cwd=folder, hash_seed=1)
    assert done.code == 0, done.err
    assert f"{EPISODES} episodes" in done.out
    assert bytes_of(folder / "run") == bytes_of(undisturbed)
    assert not (folder / "run" / "parts").exists()
    assert not list((folder / "run").glob("*.aside"))


def _place(grid: Path, folder: Path) -> Path:
    (folder / "grid.net.xml").write_bytes(grid.read_bytes())
    (folder / "our_planners.py").write_text(PLANNERS)
    return folder


def test_ctrl_c_in_a_dry_run_keeps_nothing(grid: Path, tmp_path: Path) -> None:
    folder = _place(grid, tmp_path)
    (folder / "endless.py").write_text(ENDLESS)
    case = '[[cases]]\nnet = "grid.net.xml"\ntarget = "endless:Endless"\n'
    scene = "[scene]\nwarmup_s = 10.0\nscenes_per_warmup = 1\nmin_neighbours = 1\n"
    (folder / "long.toml").write_text(f"episodes = 1\nhorizon_s = 4.0\n{case}{scene}")
    running = begin("sweep", "long.toml", "--dry-run", cwd=folder)
    said = _interrupted_while_it_plans(running, folder)
    assert (running.returncode, said.splitlines()) == (130, ["interrupted; a dry run keeps nothing"])


def test_ctrl_c_in_a_bench_names_the_command_that_continues(grid: Path, tmp_path: Path) -> None:
    folder = _place(grid, tmp_path)
    (folder / "endless.py").write_text(ENDLESS)
    words = (
        "defects",
        "--target",
        "endless:Endless",
        "--net",
        "grid.net.xml",
        "--defect",
        "late",
        "--scenes",
        "5",
    )
    scene = (
        "--set",
        "scene.warmup_s=10",
        "--set",
        "scene.min_neighbours=1",
        "--horizon",
        "4",
        "--workers",
        "1",
    )
    running = begin(*words, *scene, "--out", "seen", cwd=folder)
    said = _interrupted_while_it_plans(running, folder)
    assert running.returncode == 130
    command = "advdiff-sumo " + " ".join((*words, *scene, "--out", "seen"))
    assert said.splitlines()[-1] == f"{KEPT}; go on with {command}"
