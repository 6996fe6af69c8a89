"""A run continues whatever a planner or policy does, and reports the fault, its place and how to repeat it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.sweep.run_folder import RunFolder
from tests.e2e.commands import TINY, Outcome, advdiff
from tests.hang_guard import with_time

PLUG_INS = '''
import json
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from advdiff_sumo.core.plan import Controls
from advdiff_sumo.traffic.sumo_traffic import SumoTraffic


def well():
    return Controls(np.zeros(10), np.zeros(10), 0.1)


def crash():
    os.kill(os.getpid(), signal.SIGSEGV)


def leave():
    os._exit(7)


def exit_():
    sys.exit(3)


def interrupt():
    raise KeyboardInterrupt


def lists():
    return Controls([0.0] * 10, [0.0] * 10, 0.1)


def uneven():
    return Controls(np.zeros(10), np.zeros(7), 0.1)


def hang():
    print("thinking", flush=True)
    while True:
        try:
            time.sleep(0.01)
        except Exception:
            pass


def eat():
    hold = []
    while True:
        hold.append(np.ones(8_000_000))


def mute():
    sys.stdout.close()
    sys.stderr = None
    return well()


class Ill:
    """Its deed in the third plan is read from a file by the first random number of the episode."""

    def start(self, road, scene, rng):
        return json.loads(Path("deeds.json").read_text())[repr(float(rng.random()))], 0

    def plan(self, road, scene, memory, rng):
        deed, plans = memory
        return globals()[deed if plans == 2 else "well"](), (deed, plans + 1)


class Always:
    """Does one thing in every plan."""

    def __init__(self, deed):
        self.deed = deed

    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        return globals()[self.deed](), None


class CannotBeMade(Always):
    def __init__(self):
        exit_()


class IllTraffic(SumoTraffic):
    def plan(self, road, scene, memory, rng):
        if scene.time_s >= 1.0:
            crash()
        return super().plan(road, scene, memory, rng)


class IllFromTheStart:
    def start(self, road, scene, rng):
        crash()

    def plan(self, road, scene, memory, rng):
        return well(), None
'''


def at(code: str, function: str) -> str:
    """Return the text in messages for the line of ``PLUG_INS`` that contains *code*."""
    line = next(k for k, text in enumerate(PLUG_INS.splitlines(), 1) if code in text)
    return f"(ill.py, line {line}, {function})"


PLAN, CRASH = at("def plan(", "plan"), at("os.kill", "crash")
CHECKED = {
    "crash": ("comes to its end", f"the worker was ended by SIGSEGV {CRASH}"),
    "leave": ("comes to its end", "the worker ended with exit code 7"),
    "exit_": ("raises nothing", f"it raised SystemExit: 3 {at('sys.exit', 'exit_')}"),
    "interrupt": ("raises nothing", f"it raised KeyboardInterrupt {at('raise Key', 'interrupt')}"),
    "lists": ("form", "accel_mps2 is of type list, not a NumPy array"),
    "uneven": ("form", "its arrays do not fit each other in shape: accel_mps2 (10,)"),
    "hang": ("comes to its end", "not finished after 40 s"),
}
KINDS = {
    "crash": (
        "planner_crashed",
        f"ended its process at 1.0 s of the episode {CRASH}: the worker was ended by SIGSEGV",
    ),
    "well": (None, ""),
    "leave": ("planner_crashed", "the worker ended with exit code 7"),
    "exit_": ("planner_error", f"target 'ill:Ill' raised SystemExit: 3 {at('sys.exit', 'exit_')}"),
    "interrupt": ("planner_error", f"raised KeyboardInterrupt {at('raise Key', 'interrupt')}"),
    "lists": ("plan_refused", f"accel_mps2 is of type list, not a NumPy array {PLAN}"),
    "uneven": ("plan_refused", f"accel_mps2 (10,), steer_rad (7,) {PLAN}"),
    "hang": ("planner_timeout", f"s at 1.0 s of the episode {at('time.sleep', 'hang')}"),
    "eat": ("out_of_memory", f"ran out of memory {at('hold.append', 'eat')}"),
    "mute": (None, ""),
}
RUN = ("run", "--net", "grid.net.xml", *TINY)


@pytest.fixture
def place(grid: Path, tmp_path: Path) -> Path:
    """Return a folder with a net and misbehaving plug-ins."""
    (tmp_path / "grid.net.xml").write_bytes(grid.read_bytes())
    (tmp_path / "ill.py").write_text(PLUG_INS)
    return tmp_path


def deeds_by_draw(seed: int) -> dict[str, str]:
    """Return first number of an episode's generator → deed of the planner in that episode."""
    root = SeedTree(seed)
    draws = (
        root.child("episode", "grid.net.xml", k).child("target").generator().random()
        for k in range(len(KINDS))
    )
    return {repr(float(draw)): deed for draw, deed in zip(draws, KINDS, strict=True)}


def rows_of(folder: Path, table: str = "episodes") -> list[dict[str, Any]]:
    return pq.read_table(folder / f"{table}.parquet").to_pylist()


def attempt(place: Path, words: tuple[object, ...], limit_s: float) -> Outcome | None:
    """Run *words* into "run" with a time limit for plans; return None if a healthy plan exceeded it."""
    shutil.rmtree(place / "run", ignore_errors=True)
    done = advdiff(*words, "--plan-timeout", limit_s, "--memory", 800, "--out", "run", cwd=place)
    kinds = [row["failure_kind"] for row in rows_of(place / "run")]
    late = [deed for deed, kind in zip(KINDS, kinds, strict=True) if kind == "planner_timeout"]
    return done if late == ["hang"] else None


@pytest.mark.slow
def test_every_deed_costs_its_own_episode_only(place: Path) -> None:
    (place / "deeds.json").write_text(json.dumps(deeds_by_draw(0)))
    words = (*RUN, "--target", "ill:Ill", "--background", "replay", "--episodes", len(KINDS))
    done = with_time(lambda limit_s: attempt(place, words, limit_s), 20.0)
    assert done.code == 0, done.err
    assert done.err == ""
    assert "Traceback" not in done.out
    rows = rows_of(place / "run")
    assert [row["failure_kind"] for row in rows] == [kind for kind, _ in KINDS.values()]
    for row, (_, message) in zip(rows, KINDS.values(), strict=True):
        assert message in (row["failure_message"] or "")
        assert row["end"] == "failed" or row["failure_kind"] is None
    states = pq.read_table(place / "run" / "states.parquet")
    for row in rows:
        target = states.filter((pc.field("episode") == row["episode"]) & pc.field("is_target"))
        steps = sorted(target["step"].to_pylist())
        assert steps == list(range(len(steps)))
        assert (
            len(steps) == 11 if row["end"] == "failed" else len(steps) > 11
        )  # all steps up to the third plan
    failures = {row["episode"]: row for row in RunFolder(place / "run").failures()}
    assert sorted(failures) == [row["episode"] for row in rows if row["end"] == "failed"]
    crashed, hung = failures[0], failures[7]
    assert crashed["attempts"] == 2
    assert "Fatal Python error: Segmentation fault" in crashed["log_tail"]
    assert "thinking" in hung["log_tail"]
    for number, row in failures.items():
        assert row["command"] == f"advdiff-sumo replay {number} --run run"
        assert row["command"] in done.out
        assert done.out.count(f"failed, 1 of {len(KINDS)}: {row['kind']}: ") >= 1

    (place / "deeds.json").write_text(json.dumps(dict.fromkeys(deeds_by_draw(0), "well")))
    again = advdiff(*words, "--out", "well", cwd=place)
    assert again.code == 0, again.err
    well = rows_of(place / "well")
    assert well[1] == rows[1]
    whole = pq.read_table(place / "well" / "states.parquet")
    for number in failures:  # before the deed, the episode is the same as without it
        told = states.filter(pc.field("episode") == number).to_pylist()
        agents = {
            row["agent"] for row in told
        }  # the record has only agents that come near the target at some time
        until = whole.filter((pc.field("episode") == number) & (pc.field("step") <= 10)).to_pylist()
        assert told == [row for row in until if row["agent"] in agents]


def test_a_policy_that_crashes_and_where_every_episode_fails(place: Path) -> None:
    done = advdiff(*RUN, "--background", "ill:IllTraffic", "--episodes", 2, "--out", "run", cwd=place)
    assert done.code == 1, done.err
    assert [row["failure_kind"] for row in rows_of(place / "run")] == ["planner_crashed"] * 2
    assert (
        done.out.count("failed, 2 of 2: planner_crashed: background 'ill:IllTraffic' ended its process") == 1
    )
    assert "Traceback" not in done.out + done.err
    assert {row["step"] for row in rows_of(place / "run", "states")} == set(range(11))


@pytest.mark.slow
def test_report_and_replay_show_where_a_planner_raised(place: Path) -> None:
    deed = ("--target", "ill:Always", "--set", "target_options.deed=exit_")
    assert advdiff(*RUN, *deed, "--episodes", 1, "--out", "run", cwd=place).code == 1
    page = (place / "run" / "report.html").read_text(encoding="utf-8")
    assert "What was said last" in page
    assert "sys.exit(3)" in page
    done = advdiff("replay", 0, "--run", "run", "--out", "again", cwd=place)
    assert done.code == 0, done.err
    assert "0: failed" in done.out
    assert "raised SystemExit: 3" in done.out
    assert "sys.exit(3)" in done.out
    assert "the same as in the run" in done.out
    by_sweep = advdiff("replay", 0, "--sweep", "run", "--out", "third", cwd=place)
    assert "the same as in the sweep" in by_sweep.out


@pytest.mark.slow
def test_a_planner_that_crashes_before_the_first_step(place: Path) -> None:
    done = advdiff(*RUN, "--target", "ill:IllFromTheStart", "--episodes", 1, "--out", "run", cwd=place)
    assert done.code == 1, done.err
    (row,) = rows_of(place / "run")
    assert (row["end"], row["failure_kind"], row["duration_s"]) == ("failed", "planner_crashed", 0.0)
    assert f"before the first step {CRASH}" in row["failure_message"]
    assert {state["step"] for state in rows_of(place / "run", "states")} == {0}


@pytest.mark.slow
def test_one_episode_of_a_run_again(place: Path) -> None:
    words = (*RUN, "--target", "lane_graph", "--episodes", 3, "--seed", 4)
    assert advdiff(*words, "--out", "run", cwd=place).code == 0
    done = advdiff("replay", 2, "--run", "run", "--out", "again", cwd=place)
    assert done.code == 0, done.err
    assert "the same as in the run" in done.out
    assert (place / "again" / "report.html").exists()
    assert rows_of(place / "again") == rows_of(place / "run")[2:]
    page = (place / "again" / "report.html").read_text()
    assert "advdiff-sumo replay 2 --run ." in page
    assert "interrupted" not in page
    refused = advdiff("replay", 3, "--run", "run", cwd=place)
    assert refused.code == 2
    assert "'3' is no episode of run; give a number from 0 to 2" in refused.err
    assert "run holds no" not in refused.err
    assert "holds no run" in advdiff("replay", 3, "--run", "nowhere", cwd=place).err


@pytest.mark.slow
@pytest.mark.parametrize("deed", CHECKED)
def test_check_planner_reports_the_deed(place: Path, deed: str) -> None:
    words = ("check-planner", "ill:Always", "--set", f"deed={deed}", "--net", "grid.net.xml")
    limit = ("--timeout", 40) if deed == "hang" else ()
    done = advdiff(*words, "--episodes", 1, "--horizon", 2, "--memory", 800, *limit, cwd=place)
    assert done.code == 1, done.err
    assert "Traceback" not in done.out + done.err
    name, message = CHECKED[deed]
    line = next(line for line in done.out.splitlines() if line.strip().startswith("fails") and name in line)
    assert message in line


@pytest.mark.parametrize("command", [("check-planner",), ("run", "--target")])
def test_a_planner_that_exits_in_its_constructor(place: Path, command: tuple[str, ...]) -> None:
    done = advdiff(*command, "ill:CannotBeMade", cwd=place)
    assert (done.code, done.out) == (2, "")
    words = "error: target 'ill:CannotBeMade' cannot be made: SystemExit: 3"
    assert done.err == f"{words} {at('sys.exit', 'exit_')}; correct it\n"
    assert not (place / "runs").exists()


@pytest.mark.slow
def test_a_sweep_ends_a_plan_that_hangs(place: Path) -> None:
    (place / "s.toml").write_text(
        "episodes = 1\nhorizon_s = 4.0\n[scene]\nwarmup_s = 10.0\nscenes_per_warmup = 2\nmin_neighbours = 1\n"
        '[[cases]]\nnet = "grid.net.xml"\ntarget = "ill:Always"\ntarget_options = { deed = "hang" }\n'
    )
    words = ("--workers", 1, "--plan-timeout", 20, "--no-report", "--out", "s")
    done = advdiff("sweep", "s.toml", *words, cwd=place)
    assert done.code == 0, done.err
    (failure,) = rows_of(place / "s", "failures")
    assert failure["kind"] == "planner_timeout"
    assert "made no plan in 20 s at 0.0 s of the episode" in failure["message"]
    (row,) = rows_of(place / "s")
    assert (row["end"], row["failure_kind"]) == ("failed", "planner_timeout")
