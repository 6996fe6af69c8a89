"""Seed scenes of a bench on the user's own nets: those of a run there, paired, in turn, and what is refused."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest
import sumolib

from advdiff_sumo.core.errors import ConfigError, InputError, NetError
from advdiff_sumo.experiments.bench.bench_config import Folder, Request
from advdiff_sumo.experiments.bench.cells import BenchCells
from advdiff_sumo.experiments.bench.defect_cells import plan_defects
from advdiff_sumo.experiments.bench.reporter import Silent
from advdiff_sumo.experiments.bench.requested_scenes import requested_scenes
from advdiff_sumo.experiments.bench.runner import check_request
from advdiff_sumo.experiments.bench.scene_list import DEFECTS_LIST, choose_scenes
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.sweep.fingerprint import digest
from advdiff_sumo.sweep.job_plan import plan_run

FAST = {"warmup_s": 10.0, "scenes_per_warmup": 2, "min_neighbours": 1}


@pytest.fixture(scope="module")
def net(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A net of four junctions, with a configuration and its route file beside it."""
    path = tmp_path_factory.mktemp("net") / "own.net.xml"
    command = [sumolib.checkBinary("netgenerate"), "--grid", "--grid.number", "2", "-o", str(path)]
    subprocess.run(command, check=True, capture_output=True)
    trip = '<routes><trip id="a" depart="7" from="A0B0" to="B0B1"/></routes>'
    path.with_name("own.rou.xml").write_text(trip)
    files = '<net-file value="own.net.xml"/><route-files value="own.rou.xml"/>'
    path.with_name("own.sumocfg").write_text(f"<configuration><input>{files}</input></configuration>")
    return path


def request(*nets: object, scenes: str = "3", **options: Any) -> Request:
    return Request(
        bench="defects",
        scenes=scenes,
        horizon_s=4.0,
        policies=("sumo",),
        targets=("lane_graph",),
        defects=("late",),
        nets=tuple(map(str, nets)),
        options=options,
    )


def planned(asked: Request, folder: Path) -> BenchCells:
    return plan_defects(Folder(folder, asked), Silent())


def test_scenes_of_a_net_are_those_of_a_run_there_with_that_seed(net: Path, tmp_path: Path) -> None:
    own = {"seed": 5, "scene": FAST, "sim": {"control_radius_m": 50.0}}
    cells = planned(request(net, **own), tmp_path)
    run = Run.prepare(RunOptions.parse({"net": str(net), "horizon_s": 4.0, "episodes": 3, **own}))
    keys = [job.scene_key for job in plan_run(run).jobs]
    assert len(set(keys)) == 3
    for cell in cells.cells:  # careful, the sound target, the defective one
        assert [job.scene_key for known, job in cells.jobs() if known is cell] == keys
    sims = {cells.plan.options(job).sim.control_radius_m for job in cells.plan.jobs}
    assert sims == {50.0}
    assert not any(cells.plan.options(job).sim.record_natural for job in cells.plan.jobs)


def test_more_scenes_hold_the_fewer_ones(net: Path, tmp_path: Path) -> None:
    few, more = (planned(request(net, scenes=n, scene=FAST), tmp_path) for n in ("2", "5"))
    assert {job.key for job in few.plan.jobs} < {job.key for job in more.plan.jobs}


def test_several_nets_take_turns(net: Path) -> None:
    scenes = requested_scenes(request(net, "motorway", net), DEFECTS_LIST, None).scenes
    assert [(one.net, one.number) for one in scenes] == [(str(net), 0), ("motorway", 0), (str(net), 1)]


def test_a_configuration_brings_its_demand_and_a_route_file_is_taken(net: Path, tmp_path: Path) -> None:
    for asked in (
        request(net.with_name("own.sumocfg")),
        request(net, demand=str(net.with_name("own.rou.xml"))),
    ):
        runs = {(one.net, Path(one.demand).name.split(".")[0]) for one in planned(asked, tmp_path).plan.cells}
        assert runs == {(str(net), "own")}


@pytest.mark.parametrize(
    ("scenes", "options", "said"),
    [
        ("four.json", {}, "--scenes four.json: has its own nets; give the number of scenes on --net"),
        ("-3", {}, "--scenes -3: give a number above 0"),
        ("0", {}, "--scenes 0: give a number above 0"),
        ("2", {"scene": {"warmpu_s": 9}}, "did you mean 'warmup_s'?"),
        ("2", {"demand": "nowhere.rou.xml"}, "nowhere.rou.xml: no such demand file"),
        ("2", {"episodes": 3}, "--set: no option 'episodes'"),
        ("2", {"background_options": {"attack": "cut-in"}}, "attack"),
    ],
)
def test_what_cannot_be_asked_of_a_net(net: Path, scenes: str, options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as refused:
        check_request(request(net, scenes=scenes, **options))
    assert said in str(refused.value)


def test_a_net_that_is_not_there_and_options_of_nets_without_one() -> None:
    with pytest.raises(NetError, match="no such net"):
        check_request(request("nowhere.net.xml"))
    with pytest.raises(ConfigError, match="--set scene: a list has its own; add --net"):
        check_request(request(scene=FAST))


def test_options_of_the_background_go_with_a_list_too(tmp_path: Path) -> None:
    asked = request(background_options={"attack": "cut-in"}).model_copy(update={"policies": ("scripted",)})
    cells = planned(asked, tmp_path)
    assert {str(cell.background_options) for cell in cells.cells} == {"{'attack': 'cut-in'}"}
    assert "demand" not in choose_scenes("3").model_dump(mode="json")  # lists keep their digests


@pytest.mark.parametrize("kind", ["targets", "policies"])
def test_a_plug_in_that_raises_while_it_is_made_is_refused_with_its_line(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = "class Fails:\n    def __init__(self):\n        raise RuntimeError('no licence')\n"
    (tmp_path / "fails_at_once.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    asked = request().model_copy(update={kind: ("fails_at_once:Fails",)})
    said = r"'fails_at_once:Fails' cannot be made: RuntimeError: no licence \(fails_at_once\.py, line 3, __init__\)"
    with pytest.raises(ConfigError, match=said):
        check_request(asked)


NEEDS_A_FILE = """
class Planner:
    def __init__(self, weights):
        self.weights = weights

    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        raise AssertionError
"""


def test_the_planner_and_not_the_careful_driver_gets_its_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "needs_a_file.py").write_text(NEEDS_A_FILE)
    monkeypatch.syspath_prepend(tmp_path)
    asked = request().model_copy(update={"targets": ("needs_a_file:Planner",)})
    with pytest.raises(ConfigError, match=r"'weights'.*target_options\.NAME=VALUE of run and defects"):
        check_request(asked)
    asked = asked.model_copy(update={"options": {"target_options": {"weights": "w.pt"}}})
    check_request(asked)
    given = [(cell.target, dict(cell.target_options)) for cell in planned(asked, tmp_path).cells]
    assert given == [
        ("careful", {}),
        ("needs_a_file:Planner", {"weights": "w.pt"}),
        ("needs_a_file:Planner", {"weights": "w.pt", "defects": ["late:strong"]}),
    ]


def test_what_was_asked_before_there_were_nets_keeps_its_digest(tmp_path: Path) -> None:
    known = Folder(tmp_path, request()).request.model_dump(mode="json")
    assert known.pop("nets") == []
    assert known.pop("options") == {}
    assert Folder(tmp_path, request()).request_digest == digest(known)
    assert (
        Folder(tmp_path, request("motorway")).request_digest
        != Folder(tmp_path, request("downtown")).request_digest
    )
