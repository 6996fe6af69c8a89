"""A planner's server in a separate process: its plans, and the outcome of each fault."""

from __future__ import annotations

import contextlib
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import (
    ConfigError,
    EpisodeFailure,
    OutOfMemoryFailure,
    PlannerCrashedError,
    PlannerError,
    PlannerTimeoutError,
    PlanRefusedError,
)
from advdiff_sumo.core.plan import Controls
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.lane_graph import LaneGraphPlanner
from advdiff_sumo.planners.planner_check import same_plan
from advdiff_sumo.planners.planner_protocol import Planner, Served
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.planners.remote import keeper
from advdiff_sumo.planners.remote import remote_planner as remote_planner_module
from advdiff_sumo.planners.remote.remote_planner import RemotePlanner
from advdiff_sumo.planners.remote.write_kit import write_kit
from tests.hang_guard import HANG_S, with_time

Made = Callable[..., RemotePlanner]
#: A server that can import only what the kit may need.
ONLY_THE_KIT = """
import sys
import tempfile

ALLOWED = {"advdiff_sumo", "faulty_server", "google", "grpc", "numpy", "typing_extensions"} | sys.stdlib_module_names


class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] not in ALLOWED:
            raise ModuleNotFoundError(f"{name} is not part of the kit's environment")


sys.meta_path.insert(0, Refuse())
from advdiff_sumo import planner_kit
from faulty_server import Faulty

assert planner_kit.__file__.startswith(sys.argv[1]), planner_kit.__file__
planner_kit.serve(Faulty)
"""


def plans(planner: RemotePlanner, road: RoadMap, scene: Scene, count: int = 2) -> list[float]:
    """Return the first acceleration of each of *count* plans of one episode."""
    rng = np.random.default_rng(5)
    memory = planner.start(road, scene, rng)
    accels = []
    for _ in range(count):
        plan, memory = planner.plan(road, scene, memory, rng)
        assert isinstance(plan, Controls)
        accels.append(float(plan.accel_mps2[0]))
    return accels


def test_the_same_seed_gives_the_same_plans(served: Made, road: RoadMap, scene: Scene) -> None:
    planner = served()
    drawn = np.random.default_rng(int(np.random.default_rng(5).integers(2**63)))
    known = 0.001 * len(road.lanes)
    assert plans(planner, road, scene) == [drawn.normal() + known + 0.1, drawn.normal() + known + 0.2]
    assert plans(planner, road, scene) == plans(served(), road, scene)


TELLS_LENGTH = """
import numpy as np
from advdiff_sumo.planner_kit import Controls, serve

class Planner:
    def start(self, road, scene, rng):
        return scene.least_plan_s

    def plan(self, road, scene, memory, rng):
        return Controls(np.array([memory, scene.least_plan_s]), np.zeros(2), 1.0), memory

serve(Planner)
"""


def test_a_server_is_told_the_time_to_the_next_plan(road: RoadMap, scene: Scene, tmp_path: Path) -> None:
    program = tmp_path / "server.py"
    program.write_text(TELLS_LENGTH)
    planner = make_target(f"exec:{sys.executable} {shlex.quote(str(program))}", {})
    assert isinstance(planner, RemotePlanner)
    for given, told in ((scene, 0.5), (replace(scene, replan_s=1.5), 1.5)):
        memory = planner.start(road, given, np.random.default_rng(0))
        plan, _ = planner.plan(road, given, memory, np.random.default_rng(0))
        assert isinstance(plan, Controls)
        assert plan.accel_mps2.tolist() == [told, told]
    planner.close()


def test_a_built_in_planner_plans_the_same_in_a_separate_process(road: RoadMap, scene: Scene) -> None:
    words = "advdiff_sumo.planners.lane_graph:LaneGraphPlanner --read-road advdiff_sumo.maps:RoadMap.read"
    remote = make_target(f"exec:{sys.executable} -m advdiff_sumo.planner_kit {words}", {})
    assert isinstance(remote, RemotePlanner)
    made = []
    for planner in (LaneGraphPlanner(), remote):
        rng = np.random.default_rng(1)
        made.append(planner.plan(road, scene, planner.start(road, scene, rng), rng)[0])
    remote.close()
    assert same_plan(*made)


@pytest.mark.parametrize(
    ("fault", "kind", "words", "trace"),
    [
        (
            "raises",
            PlannerError,
            r"raised RuntimeError: out of ideas \(\w+\.py, line \d+, raises\)$",
            "in raises",
        ),
        ("panics", PlannerError, "raised PanicException: called unwrap\\(\\) on a None value", "in panics"),
        ("interrupts", PlannerError, "raised KeyboardInterrupt: by itself", "in interrupts"),
        ("returns", PlanRefusedError, "plan\\(\\) returned dict", ""),
        ("eats", OutOfMemoryFailure, "ran out of memory: out of memory too much", "in eats"),
        ("fills", OutOfMemoryFailure, "ran out of memory: out of memory DefaultCPUAllocator", "in fills"),
        ("segfaults", PlannerCrashedError, "its server was ended by SIGSEGV", ""),
        (
            "exits",
            PlannerCrashedError,
            "its server ended with exit code 3",
            "SystemExit: 3 (faulty_server.py, line",
        ),
        pytest.param(
            "hangs", PlannerTimeoutError, "did not answer MakePlan within", "thinking", marks=pytest.mark.slow
        ),
    ],
)
def test_each_fault_is_a_typed_failure_and_the_next_episode_begins(
    served: Made, road: RoadMap, scene: Scene, fault: str, kind: type[EpisodeFailure], words: str, trace: str
) -> None:
    def attempt(limit_s: float) -> tuple[list[EpisodeFailure], bool] | None:
        """Return two failures and whether the next episode began; None if a healthy call was late."""
        planner = served(fault, **({"plan_timeout_s": limit_s} if fault == "hangs" else {}))
        failures: list[EpisodeFailure] = []
        try:
            for _ in range(2):
                with pytest.raises(EpisodeFailure) as caught:
                    plans(planner, road, scene)
                failures.append(caught.value)
            well = fault == "returns" or bool(np.isfinite(plans(planner, road, scene, count=1)).all())
        except PlannerTimeoutError:
            return None
        late = any("StartEpisode" in str(failure) for failure in failures)
        return None if late else (failures, well)

    failures, well = with_time(attempt, 6.0)
    for failure in failures:
        assert isinstance(failure, kind)
        assert re.search(words, str(failure))
        assert trace in str(failure.__cause__)
    assert well


BY_HAND = """
import os, sys
from concurrent.futures import ThreadPoolExecutor

import grpc

from advdiff_sumo.planner_kit import messages


def call(name, request_class, reply_class):
    def handler(request, context):
        print(f"doing {name}", flush=True)
        if name == sys.argv[1]:
            context.abort(grpc.StatusCode[sys.argv[2]], "solver gave up")
        return reply_class(protocol_version=1) if name == "Describe" else reply_class()

    parse, write = request_class.FromString, reply_class.SerializeToString
    return grpc.unary_unary_rpc_method_handler(handler, request_deserializer=parse, response_serializer=write)


calls = {name: call(name, *classes) for name, classes in messages.CALLS.items()}
server = grpc.server(ThreadPoolExecutor(1))
server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(messages.SERVICE, calls),))
server.add_insecure_port(os.environ["ADVDIFF_PLANNER_ADDRESS"])
server.start()
server.wait_for_termination()
"""


@pytest.mark.parametrize(
    ("call", "status", "kind", "words"),
    [
        ("MakePlan", "INTERNAL", PlannerError, "raised solver gave up"),
        ("StartEpisode", "NOT_FOUND", PlannerError, "refused StartEpisode: NOT_FOUND solver gave up"),
        (
            "MakePlan",
            "DEADLINE_EXCEEDED",
            PlannerError,
            "refused MakePlan: DEADLINE_EXCEEDED solver gave up",
        ),
        ("MakePlan", "UNAVAILABLE", PlannerCrashedError, "no server answered MakePlan \\(solver gave up\\)"),
    ],
)
def test_an_error_status_keeps_its_text_and_what_the_server_wrote(
    road: RoadMap,
    scene: Scene,
    tmp_path: Path,
    call: str,
    status: str,
    kind: type[EpisodeFailure],
    words: str,
) -> None:
    program = tmp_path / "server.py"
    program.write_text(BY_HAND)
    planner = make_target(f"exec:{sys.executable} {shlex.quote(str(program))} {call} {status}", {})
    assert isinstance(planner, RemotePlanner)
    with pytest.raises(EpisodeFailure, match=words) as caught:
        plans(planner, road, scene)
    planner.close()
    assert type(caught.value) is kind
    assert str(caught.value.__cause__).endswith(f"doing {call}")


def test_what_a_server_writes_is_shown_as_the_episode_ends(
    served: Made, road: RoadMap, scene: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    planner = served()
    for end in ("collision", "horizon"):
        planner.end(planner.start(road, scene, np.random.default_rng(0)), end, 1.0, "")
        assert capsys.readouterr().err == f"ended: {end}\n"


TALKS = """
import ctypes
import numpy as np
from advdiff_sumo.planner_kit import Controls, serve

class Planner:
    episodes = 0

    def start(self, road, scene, rng):
        self.episodes += 1
        print(f"episode {self.episodes}", flush=True)

    def plan(self, road, scene, memory, rng):
        if self.episodes == 3:
            ctypes.string_at(0)
        return Controls(np.zeros(10), np.zeros(10), 0.1), memory

print("loading", flush=True)
serve(Planner)
"""


def test_a_failure_has_what_the_server_wrote_in_its_episode_and_at_its_start(
    road: RoadMap, scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is stored of an episode must not depend on the episodes before it, which another worker may have driven."""
    program = tmp_path / "server.py"
    program.write_text(TALKS)
    planner = make_target(f"exec:{sys.executable} {shlex.quote(str(program))}", {})
    assert isinstance(planner, RemotePlanner)
    for failure, shown in (("", "loading\nepisode 1\n"), ("nan", "loading\nepisode 2\n")):
        planner.end(planner.start(road, scene, np.random.default_rng(0)), "failed", 1.0, failure)
        assert capsys.readouterr().err == shown
    with pytest.raises(PlannerCrashedError) as caught:
        plans(planner, road, scene)
    assert str(caught.value.__cause__) == "loading\nepisode 3"


def test_a_plan_that_is_not_a_number_is_left_to_the_simulation(
    served: Made, road: RoadMap, scene: Scene
) -> None:
    planner = served("nan")
    rng = np.random.default_rng(0)
    memory = planner.start(road, scene, rng)
    planner.plan(road, scene, memory, rng)
    plan, _ = planner.plan(road, scene, memory, rng)
    assert isinstance(plan, Controls)
    assert np.isnan(plan.accel_mps2[3])


def test_no_process_stays_behind(served: Made, faulty: Path, road: RoadMap, scene: Scene) -> None:
    child = f"left-behind by {faulty}"
    planner = served("child")
    planner.start(road, scene, np.random.default_rng(0))
    while not running(child):  # between fork and exec it has its parent's command line
        time.sleep(0.01)
    planner.close()
    assert not running(child, str(faulty))


def test_a_defect_leaves_check_end_and_close_as_they_are(faulty: Path, road: RoadMap, scene: Scene) -> None:
    defects = {"defects": ["late:1.0"]}
    missing = make_target("exec:no-such-command-anywhere", defects)
    assert isinstance(missing, Served)
    with pytest.raises(ConfigError, match="correct the command"):
        missing.check()
    target = make_target(f"exec:{sys.executable} {shlex.quote(str(faulty))}", defects)
    assert isinstance(target, Served)
    assert isinstance(target, Planner)
    target.check()
    rng = np.random.default_rng(0)
    memory = target.start(road, scene, rng)
    _, memory = target.plan(road, scene, memory, rng)
    target.end(memory, "collision", 1.0, "")
    with pytest.raises(PlannerError, match="was not started here"):  # the server has deleted the episode
        target.plan(road, scene, memory, rng)
    target.close()
    assert not running(str(faulty))


FIRST_THREAD_ENDS = """
import ctypes, pathlib, subprocess, sys, threading, time

def go_on():
    task = pathlib.Path(f"/proc/self/task/{pathlib.os.getpid()}/stat")
    while task.read_text().rpartition(")")[2].split()[0] != "Z":
        time.sleep(0.01)
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)", "of " + __file__])
    time.sleep(600)

threading.Thread(target=go_on).start()
ctypes.CDLL(None).pthread_exit(None)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="threads that outlive the first one are Linux's")
def test_no_process_of_a_server_whose_first_thread_ended_stays_behind(tmp_path: Path) -> None:
    program = tmp_path / "server.py"
    program.write_text(FIRST_THREAD_ENDS)
    command = [sys.executable, "-I", "-S", keeper.__file__, sys.executable, str(program)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) as process:
        while not running(f"sleep(600) of {program}"):
            assert process.poll() is None
            time.sleep(0.01)
        assert process.stdin is not None
        process.stdin.close()
        process.wait(HANG_S)
    assert not running(f"sleep(600) of {program}")


ELSEWHERE = """
import importlib.util, os, pathlib, sys

spec = importlib.util.spec_from_file_location("keeper", sys.argv[1])
keeper = importlib.util.module_from_spec(spec)
spec.loader.exec_module(keeper)
if hasattr(os, "pidfd_open"):
    del os.pidfd_open
keeper.PROC = pathlib.Path("/no-such-folder")
sys.argv[1:] = sys.argv[2:]
keeper.main()
"""
DEAF_WITH_CHILD = """
import signal, subprocess, sys, time

signal.signal(signal.SIGTERM, signal.SIG_IGN)
subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)", "of " + __file__])
time.sleep(600)
"""


def kept_elsewhere(*command: str) -> subprocess.Popen[bytes]:
    """Start the keeper of a command as on a system without pidfd and /proc."""
    words = [sys.executable, "-I", "-S", "-c", ELSEWHERE, str(keeper.__file__), *command]
    return subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


@pytest.mark.skipif(sys.platform != "linux", reason="the test itself looks into /proc")
def test_without_pidfd_and_proc_a_server_and_its_child_end_with_this_process(tmp_path: Path) -> None:
    program = tmp_path / "server.py"
    program.write_text(DEAF_WITH_CHILD)
    with kept_elsewhere(sys.executable, str(program)) as process:
        while not running(f"sleep(600) of {program}"):
            assert process.poll() is None
            time.sleep(0.01)
        out, _ = process.communicate(timeout=HANG_S)
    assert out.split() == [b"-9"]
    until = time.monotonic() + HANG_S
    while running(str(program)):  # killed, but not removed yet
        assert time.monotonic() < until
        time.sleep(0.01)


def test_without_pidfd_and_proc_the_exit_code_is_reported() -> None:
    with kept_elsewhere(sys.executable, "-c", "raise SystemExit(3)") as process:
        process.wait(HANG_S)
        assert process.stdout is not None
        assert process.stdout.read().split() == [b"3"]


def running(*words: str) -> list[str]:
    """Return the command lines of the machine's processes that contain one of *words*."""
    lines = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            lines.append(path.read_bytes().replace(b"\0", b" ").decode(errors="replace"))
    return [line for line in lines if any(word in line for word in words)]


def test_the_kit_needs_only_grpcio_protobuf_and_numpy(
    faulty: Path, road: RoadMap, scene: Scene, tmp_path: Path
) -> None:
    kit = tmp_path / "kit"
    write_kit(kit)
    shutil.copy(faulty, kit)
    (kit / "main.py").write_text(ONLY_THE_KIT)
    planner = make_target(f"exec:env PYTHONPATH={kit} {sys.executable} {kit}/main.py {kit}", {})
    assert isinstance(planner, RemotePlanner)
    assert len(plans(planner, road, scene)) == 2
    planner.close()


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("grpc://here", {}, "write it like grpc://localhost:50051"),
        ("exec:", {}, "names no command"),
        ("exec:python 'x", {}, "close the quotation marks"),
        ("grpc://localhost:1", {"plan_timeout": 1.0}, "did you mean 'plan_timeout_s'"),
    ],
)
def test_an_invalid_name_is_refused(name: str, options: dict[str, float], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        make_target(name, options)


def test_a_missing_server_is_reported_before_anything_is_run() -> None:
    planner = make_target("grpc://localhost:1", {})
    assert isinstance(planner, RemotePlanner)
    with pytest.raises(ConfigError, match=r"no server answered Describe; start it first"):
        planner.check()
    planner = make_target("exec:false", {})
    assert isinstance(planner, RemotePlanner)
    with pytest.raises(ConfigError, match="its command ended with exit code 1; correct the command"):
        planner.check()


def test_a_server_started_by_another_process(
    faulty: Path, road: RoadMap, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = f"unix:{tmp_path}/socket"
    command = [sys.executable, "-m", "advdiff_sumo.planner_kit", "faulty_server:Faulty", "--address", address]
    planner = make_target(f"grpc://{address}", {})
    assert isinstance(planner, RemotePlanner)
    with subprocess.Popen(command, cwd=faulty.parent) as server:
        assert len(plans(planner, road, scene)) == 2  # waits for the server
        planner.check()
        assert server.poll() is None
        memory = planner.start(road, scene, np.random.default_rng(0))
        server.kill()
    with pytest.raises(PlannerCrashedError, match="no server answered MakePlan"):
        planner.plan(road, scene, memory, np.random.default_rng(0))
    monkeypatch.setattr(remote_planner_module, "_CONNECT_S", 0.5)
    with pytest.raises(PlannerCrashedError, match=r"no server answered Describe within 0\.5 s"):
        planner.start(road, scene, np.random.default_rng(0))


def test_a_deep_temporary_folder_is_no_place_for_a_socket(
    served: Made, road: RoadMap, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deep = tmp_path / ("deep" * 25)
    deep.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(deep))
    assert np.isfinite(plans(served("child"), road, scene, count=1)).all()
    assert list(deep.iterdir()) == []
