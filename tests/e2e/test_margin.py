"""``advdiff-sumo margin`` from the command line."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import advdiff

SCENE = (
    *("--net", "motorway", "--target", "lane_graph", "--seed", "2", "--horizon", "10"),
    *("--set", "scene.situation=following", "--set", "scene.min_speed_mps=8"),
    *("--set", "scene.warmup_s=20", "--set", "scene.scenes_per_warmup=1"),
)

STRAIGHT_ON = """
import numpy as np
from advdiff_sumo.core.plan import Controls

class StraightOn:
    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        return Controls(np.zeros(5), np.zeros(5), 0.1), None
"""


RAISES = """
class Raises:
    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        raise ValueError("no plan")
"""


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--attack", "any"), "--attack any: a margin is known for hard-stop, cut-in"),
        (("--by", "gap"), "--by gap: hard-stop is as severe as its braking; choose that"),
        (("--attack", "all", "--by", "gap"), "--by goes with one attack; leave it out"),
        (("--attack", "all", "--within", "1"), "--within goes with one attack; leave it out"),
        (("--set", "background_options.attack=cut-in"), "attack=cut-in: name the attack with --attack"),
        (
            ("--set", "background_options.braking_mps2=3"),
            "braking_mps2=3: the search varies it; leave it out",
        ),
        (("--set", "background=sumo"), "--set background=sumo: a margin is that of background scripted"),
        (("--set", "episodes=3"), "--set episodes=3: a margin is that of one seed scene; leave it out"),
    ],
)
def test_what_has_no_severity_is_refused(words: tuple[str, ...], message: str, tmp_path: Path) -> None:
    outcome = advdiff("margin", *words, cwd=tmp_path)
    assert outcome.code == 2
    assert message in outcome.err


@pytest.mark.slow
def test_a_planner_that_raises_is_a_failure_and_not_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "av.py").write_text(RAISES, encoding="utf-8")
    done = advdiff("margin", *SCENE, "--target", "av:Raises", "--out", "m", cwd=tmp_path)
    assert (done.code, done.out) == (1, "")
    assert "the episode with braking of 8.5 m/s² failed: target 'av:Raises' raised ValueError" in done.err


@pytest.mark.slow
def test_there_is_no_margin_if_no_vehicle_could_attack(tmp_path: Path) -> None:
    words = ("--attack", "cut-out", "--horizon", "2", "--out", "m")
    done = advdiff("margin", *SCENE, *words, cwd=tmp_path)
    assert done.code == 1
    assert (
        "nobody was in a position for cut-out: the episode lasted 2.0 s (--horizon); raise scene" in done.out
    )
    assert "look at m" in done.out
    again = advdiff("margin", *SCENE, *words, "--json", cwd=tmp_path)
    said = json.loads(again.out)
    assert (again.code, said["failing"], said["passing"]) == (1, None, None)
    assert said["why"].startswith("nobody was in a position for cut-out")


@pytest.mark.slow
def test_the_failing_and_the_passing_trial_and_a_second_call(tmp_path: Path) -> None:
    words = ("margin", *SCENE, "--defect", "weak-brakes:3", "--within", "4", "--out", "m")
    done = advdiff(*words, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "lane_graph: copes with hard-stop at braking of" in done.out
    failing, passing = pq.read_table(tmp_path / "m" / "episodes.parquet").to_pylist()
    assert (failing["valid_failure"], passing["valid_failure"]) == (True, False)
    assert 'id="margins"' in (tmp_path / "m" / "report.html").read_text(encoding="utf-8")
    *_, last = trials(tmp_path / "m")
    assert (last["value"], last["encounter"], last["valid_failure"]) == ("8.5", "true", "true")
    assert {row["episode"] for row in trials(tmp_path / "m")} == {"", "0", "1"}
    again = advdiff(*words, cwd=tmp_path)
    assert again.out == done.out
    said = json.loads(advdiff(*words, "--json", cwd=tmp_path).out)
    assert (said["attack"], said["parameter"], said["unit"]) == ("hard-stop", "braking", "m/s²")
    assert [f"{said['failing']:g}", f"{said['passing']:g}"] == values_of_neighbours(tmp_path / "m")
    assert f"lane_graph: {said['why']}\n" in done.out
    assert Path(said["report"]) == (tmp_path / "m" / "report.html").resolve()


@pytest.mark.slow
def test_a_target_that_leaves_the_road_needs_no_attack(tmp_path: Path) -> None:
    (tmp_path / "straight.py").write_text(STRAIGHT_ON, encoding="utf-8")
    words = ("--target", "straight:StraightOn", "--seed", "3", "--horizon", "10", "--out", "m")
    done = advdiff("margin", *words, cwd=tmp_path)
    assert done.code == 0, done.err
    told = "it leaves the road by itself and touches nobody"
    assert f"hard-stop, braking of 1 m/s²: valid failure, but {told}" in done.out
    assert f"fails at the mildest hard-stop already, braking of 1 m/s²: {told}" in done.out
    page = (tmp_path / "m" / "report.html").read_text(encoding="utf-8")
    assert "<td>–</td><td>1 m/s² (not with who attacks)</td>" in page


@pytest.mark.nightly
@pytest.mark.slow
def test_all_kinds_of_attack_in_one_scene(tmp_path: Path) -> None:
    done = advdiff("margin", *SCENE, "--attack", "all", "--out", "m", cwd=tmp_path)
    assert done.code == 0, done.err
    kinds = [(row["attack"], row["by"]) for row in trials(tmp_path / "m")]
    assert list(dict.fromkeys(kinds)) == [
        ("hard-stop", "braking"),
        ("cut-in", "gap"),
        ("cut-in", "braking"),
        ("stop-and-go", "braking"),
        ("blocked-lane", "braking"),
        ("double", "braking"),
        ("slow-merge", "gap"),
        ("pull-out", "gap"),
        ("crossing", "time"),
        ("oncoming", "time"),
        ("cut-out", "time"),
    ]
    for kind in ("crossing", "oncoming"):  # no junction is near
        assert f"nobody was in a position for {kind}" in done.out


def trials(folder: Path) -> list[dict[str, str]]:
    with (folder / "margin.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def values_of_neighbours(folder: Path) -> list[str]:
    kept = sorted((row["episode"], row["value"]) for row in trials(folder) if row["episode"])
    return [value for _, value in kept]


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "sweep.toml").write_text("[sweep]\n")
    refused = advdiff("margin", *SCENE, "--out", "s", cwd=tmp_path)
    assert (refused.code, refused.out) == (2, "")
    assert "s: holds a sweep; choose another --out" in refused.err
    (tmp_path / "s" / "margin.json").write_text("{}")
    other = advdiff("margin", *SCENE, "--out", "s", cwd=tmp_path)
    assert other.code == 2
    assert "holds the margin of another target, net, seed or option" in other.err
    assert (tmp_path / "s" / "sweep.toml").read_text() == "[sweep]\n"


SWEEP = """
episodes = 4
horizon_s = 20.0
scene = { min_speed_mps = 8.0 }

[[cases]]
net = "motorway"
target = "lane_graph"
target_options = { defects = ["weak-brakes:2.5"] }
background = "scripted"
"""


@pytest.mark.slow
def test_a_finding_of_a_sweep_and_its_margin(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(SWEEP, encoding="utf-8")
    swept = advdiff("sweep", "s.toml", "--out", "s", cwd=tmp_path)
    assert swept.code == 0, swept.err
    rows = pq.read_table(tmp_path / "s" / "episodes.parquet").to_pylist()
    finding = next(row for row in rows if row["valid_failure"] and row["number"])
    command = f"advdiff-sumo margin {finding['key']} --sweep ."
    assert command in (tmp_path / "s" / "report.html").read_text(encoding="utf-8")
    done = advdiff("margin", finding["key"], "--sweep", "s", "--within", "1", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    said = json.loads(done.out)
    assert (said["attack"], said["parameter"]) == (finding["attacker_manoeuvre"], "braking")
    assert said["failing"] > said["passing"]
    failing, passing = pq.read_table(Path(said["folder"]) / "episodes.parquet").to_pylist()
    assert {row["scene"] for row in (finding, failing, passing)} == {finding["scene"]}
    assert failing["collision_partner"] == finding["collision_partner"]
    (command,) = (Path(said["folder"]) / "margin.txt").read_text(encoding="utf-8").splitlines()
    words = ("margin", finding["key"], "--sweep", str((tmp_path / "s").resolve()), "--within", "1")
    assert command == f"advdiff-sumo {' '.join(words)} --out ../again"
    sound = advdiff(*words, "--attack", "hard-stop", "--target", "lane_graph", "--json", cwd=tmp_path)
    assert json.loads(sound.out)["failing"] is None


@pytest.mark.slow
def test_episodes_without_such_an_attack_and_options_that_contradict(tmp_path: Path) -> None:
    run = advdiff("run", "--episodes", "1", "--horizon", "2", "--no-report", "--out", "r", cwd=tmp_path)
    assert run.code == 0, run.err
    for words, message in (
        (
            ("0", "--run", "r"),
            "episode 0: it does not say what was done against the target; choose an --attack",
        ),
        (
            ("0", "--run", "r", "--seed", "2"),
            "--seed: the seed scene is that of episode 0; leave --seed or the",
        ),
        (("--run", "r"), "r: name an episode of it, too: its key or number, as for replay"),
        (("3", "--run", "r"), "'3' is no episode of r"),
    ):
        refused = advdiff("margin", *words, cwd=tmp_path)
        assert (refused.code, refused.out) == (2, "")
        assert message in refused.err
