"""Invalid answers: a server in any language may send any bytes, and each fault is reported in one sentence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError, OutOfMemoryFailure, PlannerError, PlanRefusedError
from advdiff_sumo.core.plan import Controls, Trajectory
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planner_kit import messages
from advdiff_sumo.planner_kit.planner_server import PlannerServer
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.planners.remote.connection import Connection
from advdiff_sumo.planners.remote.remote_planner import RemotePlanner
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from tests.hang_guard import HANG_S
from tests.sim.scenes import episode

ZEROS = np.zeros(10)
WELL = messages.Plan(controls=messages.Controls(dt_s=0.1, accel_mps2=[0.0] * 10, steer_rad=[0.0] * 10))
UNREADABLE = "answered MakePlan with bytes that are no Plan of planner.proto; build its server"


class Answers:
    """Serves a planner whose second plan, and whose description, are the given bytes."""

    def __init__(self, plan: bytes | None = None, description: bytes | None = None) -> None:
        self.plan, self.description, self.plans = plan, description, 0

    def calls(self) -> dict[str, Callable[[bytes], bytes]]:
        return {
            "Describe": lambda _: (
                self.description or messages.Description(protocol_version=1).SerializeToString()
            ),
            "LoadMap": lambda _: b"",
            "StartEpisode": lambda _: b"",
            "MakePlan": self._plan,
            "EndEpisode": lambda _: b"",
        }

    def _plan(self, request: bytes) -> bytes:
        del request
        self.plans += 1
        return self.plan if self.plan is not None and self.plans == 2 else WELL.SerializeToString()


@contextmanager
def answering(answers: Answers, folder: Path) -> Iterator[RemotePlanner]:
    """Yield the planner that is connected to a server with *answers*."""
    handlers = {
        name: grpc.unary_unary_rpc_method_handler(lambda request, _, call=call: call(request))
        for name, call in answers.calls().items()
    }
    with ThreadPoolExecutor(1) as one:
        server = grpc.server(one)
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(messages.SERVICE, handlers),))
        server.add_insecure_port(f"unix:{folder}/socket")
        server.start()
        planner = make_target(f"grpc://unix:{folder}/socket", {})
        assert isinstance(planner, RemotePlanner)
        yield planner
        planner.close()
        server.stop(grace=None).wait()


def test_a_map_beyond_the_servers_limit_is_no_lack_of_memory(tmp_path: Path) -> None:
    """The server has gRPC's default limit of 4 MB; the map of a city is larger."""
    with answering(Answers(), tmp_path):
        connection = Connection(f"unix:{tmp_path}/socket", "mine")
        connection.call("LoadMap", messages.Map(net_path="x" * 4_000_000), HANG_S)
        large = messages.Map(net_path="x" * 5_000_000)
        told = (
            r"mine: its server takes no message as large as that of LoadMap \(.* larger than max .*\); lift"
        )
        with pytest.raises(PlannerError, match=told) as raised:
            connection.call("LoadMap", large, HANG_S)
        connection.close()
    assert not isinstance(raised.value, OutOfMemoryFailure)


def packed(field: int, count: int, content: bytes) -> bytes:
    """Return a plan of controls whose *field* claims to have *count* bytes, but has *content*."""
    inner = bytes([field << 3 | 2, count]) + content
    return bytes([2 << 3 | 2, len(inner)]) + inner


BYTES = {
    "no doubles": (packed(2, 12, bytes(12)), UNREADABLE),
    "cut off": (WELL.SerializeToString()[:-5], UNREADABLE),
    "longer than it is": (packed(2, 80, bytes(8)), UNREADABLE),
    "text": (b"hello", UNREADABLE),
    "nothing": (b"", "answered without a plan; fill in trajectory or controls"),
    "one array": (packed(2, 16, bytes(16)), r"different lengths \(accel_mps2 2, steer_rad 0\); send as many"),
}


@pytest.mark.parametrize("case", BYTES)
def test_the_episode_fails_in_one_sentence_and_keeps_what_was_driven(
    networks: Path, tmp_path: Path, case: str
) -> None:
    content, words = BYTES[case]
    road = RoadMap.read(networks / "downtown.net.xml")
    options = SceneOptions.parse({"warmup_s": 15.0, "scenes_per_warmup": 1})
    start = NaturalTraffic(road, None, options, SimOptions.parse({}), 8.0, SeedTree(3)).batch(0)[0]
    with answering(Answers(content), tmp_path) as planner:
        record, _ = episode(start, road, planner, "sumo", 2.0).run()
        assert record.failure is not None
        assert record.failure.kind == "plan_refused"
        with pytest.raises(PlanRefusedError, match=words):
            raise PlanRefusedError(record.failure.message)
        assert record.failure.message.startswith(f"target 'grpc://unix:{tmp_path}/socket' answered ")
        assert record.tracks.steps == 6
        again, _ = episode(start, road, planner, "sumo", 1.0).run()
        assert again.failure is None


def test_an_unreadable_description_is_reported_before_anything_is_run(tmp_path: Path) -> None:
    with (
        answering(Answers(description=b"hello"), tmp_path) as planner,
        pytest.raises(ConfigError, match=r"answered Describe with bytes that are no Description .* writes$"),
    ):
        planner.check()


def test_a_server_without_a_version_is_refused(tmp_path: Path) -> None:
    silent = messages.Description(name="mine").SerializeToString()
    with (
        answering(Answers(description=silent), tmp_path) as planner,
        pytest.raises(ConfigError, match=r"version 0 of the protocol.* set protocol_version .* writes$"),
    ):
        planner.check()


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        (Trajectory(np.zeros((2, 10)), ZEROS, ZEROS, 0.1), r"xy_m has shape \(2, 10\), not \(T, 2\)"),
        (Trajectory(np.zeros(21), ZEROS, ZEROS, 0.1), r"xy_m has shape \(21,\), not \(T, 2\)"),
        (Controls(np.zeros((10, 1)), ZEROS, 0.1), r"accel_mps2 has shape \(10, 1\)"),
        (Controls(ZEROS + 1j, ZEROS, 0.1), "accel_mps2 holds complex128, not numbers"),
        (Controls(None, ZEROS, 0.1), "accel_mps2 holds object, not numbers"),  # type: ignore[arg-type] # on purpose
        (Controls(ZEROS, ZEROS[:3], 0.1), "do not fit each other in shape"),
        (Controls(ZEROS, ZEROS, None), "dt_s is of type NoneType"),  # type: ignore[arg-type] # on purpose
    ],
)
def test_a_python_server_refuses_arrays_that_do_not_fit(plan: Any, words: str) -> None:
    with pytest.raises(
        Exception, match=rf"that cannot be driven: .*{words}.* \(test_answers\.py, line \d+, plan\)$"
    ):
        _served(plan)


@pytest.mark.parametrize("values", [[1] * 10, np.ones(10, np.int8), np.ones(10, np.float32)])
def test_it_accepts_any_numeric_type(values: Any) -> None:
    assert list(_served(Controls(values, values, 0.1)).controls.accel_mps2) == [1.0] * 10


class _Gives:
    """A planner with one plan."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def start(self, road: Any, scene: Any, rng: np.random.Generator) -> None:
        """Nothing to remember."""

    def plan(self, road: Any, scene: Any, memory: None, rng: np.random.Generator) -> tuple[Any, None]:
        return self.answer, None


def _served(plan: Any) -> Any:
    """Return the message that a Python server makes from *plan*."""
    own = messages.Object(id="t", x_m=[0.0], y_m=[0.0], yaw_rad=[0.0], speed_mps=[1.0])
    scene = messages.Scene(step_s=0.5, own=own)
    server = PlannerServer(_Gives(plan), "gives", "", False, lambda _: None)
    server._roads["map"] = object()  # any object serves as the map
    server.StartEpisode(messages.StartRequest(episode_id="e", map_id="map", scene=scene))
    return server.MakePlan(messages.PlanRequest(episode_id="e", scene=scene))
