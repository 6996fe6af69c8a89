"""Quiet runs, JSON results, lists, logs, and SUMO configurations."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from advdiff_sumo.planners.defects import DEFECTS
from advdiff_sumo.planners.planner_registry import TARGETS
from tests.e2e.commands import TINY, Outcome, advdiff
from tests.e2e.conftest import sentence

RUN = ("run", "--net", "grid.net.xml", "--episodes", 2, *TINY)
SWEEP = """
episodes = 1
horizon_s = 2.0
scene = { warmup_s = 10.0, scenes_per_warmup = 2, min_neighbours = 1 }
[grid]
nets = ["grid.net.xml"]
targets = ["IDM"]
backgrounds = ["sumo"]
"""


def test_json_is_one_object_and_nothing_else(workplace: Path) -> None:
    done = advdiff(*RUN, "--target", "our_planners:Raises", "--json", "--out", "run", cwd=workplace)
    assert (done.code, done.err) == (1, ""), "every episode failed"
    told = json.loads(done.out)
    assert told["folder"] == str(workplace / "run")
    assert Path(told["report"]).exists()
    assert (told["episodes"], told["finished"], told["failed"]) == (2, 0, {"planner_error": 2})


def test_a_run_without_a_report(here: Callable[..., Outcome], workplace: Path) -> None:
    told = json.loads(here(*RUN, "--no-report", "--json", "--out", "run").out)
    assert (told["episodes"], told["report"]) == (2, None)
    assert not (workplace / "run" / "report.html").exists()
    goes_on = ("run", "--resume", "--out", "run")
    assert here(*goes_on, "--no-report").out.endswith("results: run\n")
    assert here(*goes_on).out.endswith("results: run  ·  look at run/report.html\n")
    assert "report.html is that of before; advdiff-sumo report run draws" in here(*goes_on, "--no-report").out


def test_a_folder_with_a_colon_in_its_name(here: Callable[..., Outcome], workplace: Path) -> None:
    """Arrow would take such a relative path for a URI."""
    assert here(*RUN, "--quiet", "--out", "late:1.0") == Outcome(0, "", "")
    assert here("verdict", "late:1.0").code == 0
    assert (workplace / "late:1.0" / "episodes.parquet").exists()


def test_a_net_with_a_comma_in_its_path_is_refused(here: Callable[..., Outcome], workplace: Path) -> None:
    shutil.copy(workplace / "grid.net.xml", workplace / "a,b.net.xml")
    refused = here("run", "--net", "a,b.net.xml", "--episodes", 1, *TINY, "--out", "run")
    assert "SUMO takes a comma for the end of a file name; rename or move" in sentence(refused)


def test_quiet_prints_nothing(here: Callable[..., Outcome], workplace: Path) -> None:
    assert here(*RUN, "--quiet", "--out", "run") == Outcome(0, "", "")
    assert "our_planners:Nothing" in sentence(here(*RUN, "-q", "--target", "our_planners:Nothing"))


def test_names_beyond_ascii_are_read_in_the_plain_locale_too(
    workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(workplace / "grid.net.xml", workplace / "größe.net.xml")
    monkeypatch.setenv("LC_ALL", "C")
    done = advdiff(
        "run", "--net", "größe.net.xml", "--episodes", 1, *TINY, "-q", "--out", "run", cwd=workplace
    )
    assert done == Outcome(0, "", "")


def test_output_of_a_planner_is_shown_unless_quiet(here: Callable[..., Outcome], workplace: Path) -> None:
    (workplace / "talker.py").write_text(
        "from our_planners import Still\n\n"
        "class Talks(Still):\n"
        "    def spoil(self, xy):\n        print('thinking')\n        return xy\n"
    )
    run = (*RUN, "--episodes", 1, "--target", "talker:Talks")
    assert "thinking" in here(*run, "--out", "a").err
    assert here(*run, "--quiet", "--out", "b") == Outcome(0, "", "")


def test_failed_episodes_are_run_again_with_a_corrected_planner(workplace: Path) -> None:
    mended = (
        "from our_planners import LaneGraphPlanner\n\n"
        "class Ours(LaneGraphPlanner):\n"
        "    def start(self, road, scene, rng):\n{fault}        return super().start(road, scene, rng)\n"
    )
    odd = "        if rng.integers(2):\n            raise RuntimeError('out of ideas')\n"
    run = (*RUN[:3], "--episodes", 4, *TINY, "--target", "ours:Ours")
    (workplace / "ours.py").write_text(mended.format(fault=odd))
    first = json.loads(advdiff(*run, "--json", "--out", "run", cwd=workplace).out)
    assert first["failed"] == {"planner_error": 4 - first["finished"]}, "some fail, some do not"
    assert 0 < first["finished"] < 4
    gate = advdiff("results", "run", "--fail-if", "valid_failures > 0", cwd=workplace)
    assert gate.code == 0, "what finished is sound"
    assert "episodes failed, which --fail-if valid_failures > 0 does not ask about" in gate.err.replace(
        "\n", " "
    )
    assert advdiff("results", "run", "--fail-if", "failures > 0", cwd=workplace).code == 1
    (workplace / "ours.py").write_text(mended.format(fault=""))
    again = ("run", "--resume", "--out", "run", "--json", "--quiet")
    assert json.loads(advdiff(*again, cwd=workplace).out)["failed"] == first["failed"], "left as it was"
    told = json.loads(advdiff(*again, "--retry-failed", cwd=workplace).out)
    assert (told["finished"], told["failed"]) == (4, {})
    advdiff(*run, "--out", "undisturbed", cwd=workplace)
    runs = [(workplace / name / "states.parquet").read_bytes() for name in ("run", "undisturbed")]
    assert runs[0] == runs[1]


def test_fail_if_fails_if_no_episode_finished(workplace: Path, here: Callable[..., Outcome]) -> None:
    (workplace / "sweep.toml").write_text(SWEEP.replace("IDM", "our_planners:Raises"))
    sweep = ("sweep", "sweep.toml", "--executor", "serial", "--no-report", "--out")
    assert here(*sweep, "open").code == 0
    shut = here(*sweep, "shut", "--fail-if", "valid_failures > 0")
    assert (shut.code, "no episode finished, so that nothing was tested" in shut.out.replace("\n", " ")) == (
        1,
        True,
    )


def test_a_planner_that_takes_other_arguments_is_refused_at_once(
    workplace: Path, here: Callable[..., Outcome]
) -> None:
    (workplace / "odd.py").write_text(
        "from our_planners import Still\n\nclass Odd(Still):\n    def start(self, scene):\n        return None\n"
    )
    said = sentence(here(*RUN, "--target", "odd:Odd", "--out", "run"))
    assert "target 'odd:Odd': start is called with road, scene, rng, and cannot be so: too many" in said
    assert not (workplace / "run").exists()


def test_retry_failed_needs_resume(here: Callable[..., Outcome]) -> None:
    assert "add --resume" in sentence(here(*RUN, "--retry-failed", "--out", "run"))
    assert "add --resume" in sentence(here("sweep", "sweep.toml", "--retry-failed"))


def test_a_run_to_go_on_with_is_named_by_its_folder(here: Callable[..., Outcome]) -> None:
    assert here(*RUN, "--quiet", "--out", "run").code == 0
    lost = sentence(here("run", "--resume", "--config", "run/run.toml"))
    assert "--resume does not say which run; add its folder with --out" in lost


def test_a_sweep_as_json(workplace: Path) -> None:
    (workplace / "sweep.toml").write_text(SWEEP)
    done = advdiff("sweep", "sweep.toml", "--executor", "serial", "--json", "--out", "s", cwd=workplace)
    assert (done.code, done.err) == (0, "")
    told = json.loads(done.out)
    assert (told["episodes"], told["missing"], told["failed"]) == (1, 0, {})


def test_no_bar_and_no_colour_in_a_pipe(here: Callable[..., Outcome], workplace: Path) -> None:
    done = here(*RUN, "--episodes", 1, "--out", "run")
    assert "━" not in done.out + done.err
    assert "\x1b" not in done.out + done.err
    assert "1 episode, rates" in done.out


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("targets", {*TARGETS.names(), "exec:COMMAND"}),
        ("backgrounds", {"sumo", "replay", "diffusion"}),
        ("nets", {"downtown", "downtown-left", "downtown-people", "motorway"}),
        ("defects", set(DEFECTS)),
        (
            "columns",
            {"episodes.valid_failure", "episodes.junction_type", "states.yaw_rad", "failures.log_tail"},
        ),
    ],
)
def test_lists(here: Callable[..., Outcome], kind: str, names: set[str]) -> None:
    told = json.loads(here("list", kind, "--json").out)[kind]
    assert names <= set(told)
    assert all(told.values())
    lines = here("list", kind).out.splitlines()
    assert [line.split()[0] for line in lines] == [name.split()[0] for name in told]


def test_a_list_of_nothing(here: Callable[..., Outcome]) -> None:
    assert "invalid value for 'kind': 'planets' is not one of" in sentence(here("list", "planets"))


def test_an_option_out_of_its_range(here: Callable[..., Outcome]) -> None:
    said = sentence(here("margin", "--within", "0"))
    assert "invalid value for '--within': input should be greater than or equal to 0.01 (see " in said


def test_logs_go_to_standard_error(workplace: Path) -> None:
    done = advdiff("-vv", *RUN, "--episodes", 1, "--out", "run", "--quiet", cwd=workplace)
    assert (done.code, done.out) == (0, "")
    assert "advdiff_sumo.sweep.scheduler: episode 000000: " in done.err
    assert "SUMO began: --net-file" in done.err


def test_a_configuration_stands_for_net_and_demand(here: Callable[..., Outcome], workplace: Path) -> None:
    net = (workplace / "grid.net.xml").read_text()
    edges = [
        line.split('id="')[1].split('"')[0]
        for line in net.splitlines()
        if "<edge id=" in line and ":" not in line
    ]
    flows = "".join(
        f'<flow id="f{k}" begin="0" end="99" number="20" from="{e}" to="{edges[0]}"/>'
        for k, e in enumerate(edges[1:5])
    )
    (workplace / "some.rou.xml").write_text(f"<routes>{flows}</routes>")
    files = '<net-file value="grid.net.xml"/><route-files value="some.rou.xml"/>'
    (workplace / "grid.sumocfg").write_text(f"<configuration><input>{files}</input></configuration>")
    words = ("run", "--episodes", 1, *TINY)
    one = here(*words, "--net", "grid.sumocfg", "--out", "one")
    two = here(*words, "--net", "grid.net.xml", "--demand", "grid.sumocfg", "--out", "two")
    assert (one.code, two.code) == (0, 0), one.err + two.err
    tables = [pq.read_table(workplace / name / "states.parquet") for name in ("one", "two")]
    assert tables[0].equals(tables[1])
    (workplace / "empty.sumocfg").write_text("<configuration/>")
    assert "names no net-file; give the .net.xml" in sentence(here(*words, "--net", "empty.sumocfg"))
