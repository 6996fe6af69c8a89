"""``--defect`` and ``advdiff-sumo defects`` as a user types them."""

from __future__ import annotations

import csv
import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from advdiff_sumo.experiments.bench.scene_list import make_list, write_scene_list
from advdiff_sumo.sim.sim_options import SceneOptions
from tests.e2e.commands import TINY, Outcome, advdiff

RUN = ("run", "--net", "motorway", "--target", "lane_graph", "--episodes", "2", *TINY)


@pytest.mark.slow
def test_a_run_with_defects_is_repeated_by_its_own_file(tmp_path: Path) -> None:
    planted = ("--defect", "localisation:2m", "--defect", "flicker:middle")
    first = advdiff(*RUN, *planted, "--out", "first", cwd=tmp_path)
    assert first.code == 0, first.err
    settings = tomllib.loads((tmp_path / "first" / "run.toml").read_text())
    assert settings["options"]["target_options"] == {"defects": ["localisation:2m", "flicker:middle"]}
    again = advdiff("run", "--config", "first/run.toml", "--out", "again", cwd=tmp_path, hash_seed=1)
    assert again.code == 0, again.err
    sound = advdiff(*RUN, "--out", "sound", cwd=tmp_path)
    assert sound.code == 0, sound.err
    states = {name: pq.read_table(tmp_path / name / "states.parquet") for name in ("first", "again", "sound")}
    assert states["first"].equals(states["again"])
    assert not states["first"].equals(states["sound"])


def test_a_planner_of_the_users_own_with_a_defect_keeps_the_contract(here: Callable[..., Outcome]) -> None:
    words = (
        "--net",
        "grid.net.xml",
        "--episodes",
        1,
        "--horizon",
        4,
        "--within-ms",
        1e6,
        "--defect",
        "late:1.0",
    )
    done = here("check-planner", "our_planners:Patient", *words)
    assert done.code == 0, done.out
    refused = here("check-planner", "lane_graph", *words[:-1], "slow-breaks:1")
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "unknown defect 'slow-breaks'; did you mean 'slow-brakes'?" in refused.err


@pytest.mark.parametrize(
    ("target", "defect", "said"),
    [
        ("lane_graph", "late:stong", "did you mean 'strong'?"),
        ("lane_graph", "late", "defect 'late' lacks its severity; give weak (0.5 s)"),
        ("lane_graph", "range:5s", "its unit is 'm', not 's'"),
        ("IDM", "tunnel:strong", "defect 'tunnel' has no form for target 'IDM', which SUMO drives"),
    ],
)
def test_a_defect_that_cannot_be_planted_gets_a_sentence(
    target: str, defect: str, said: str, here: Callable[..., Outcome]
) -> None:
    done = here("run", "--net", "grid.net.xml", "--target", target, "--defect", defect, "--out", "out")
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert said in done.err


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a list of four seed scenes of dense traffic."""
    path = tmp_path_factory.mktemp("scenes") / "four.json"
    scene = SceneOptions(
        warmup_s=10.0, scenes_per_warmup=4, spacing_s=2.0, density_per_km=10.0, max_vehicles=60
    )
    write_scene_list(path, make_list(4, 5, "a test", ("motorway",), scene, 5.0))
    return path


@pytest.mark.slow
def test_detections_of_a_users_own_test(scenes: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from advdiff_sumo.planners.lane_graph import LaneGraphPlanner\n\n\nclass Mine(LaneGraphPlanner):\n    pass\n"
    )
    words = ("defects", "--target", "mine:Mine", "--background", "sumo", "--scenes", str(scenes))
    more = ("--horizon", "5", "--workers", "1", "--out", "seen")
    first = advdiff(*words, "--defect", "localisation:3.5", *more, cwd=tmp_path)
    assert first.code == 0, first.err
    assert "mine:Mine" in first.out
    assert "detects" in first.out
    row = _detections(tmp_path / "seen")["localisation:3.5"]
    assert (row["background"], row["target"], row["scenes"]) == ("sumo", "mine:Mine", "4")
    assert (
        int(row["failures"]) == int(row["only_defect"]) > 0
    )  # the defect shifts the vehicle by 3.5 m to the right, off the road or into another lane
    printed = advdiff(*words, "--defect", "localisation:3.5", *more, cwd=tmp_path)
    assert "to do" not in printed.out
    assert "localisation:3.5" in printed.out
    assert "has changed" not in printed.err

    with (tmp_path / "mine.py").open("a") as file:
        file.write("# mended\n")
    said: list[str] = []
    for _ in range(2):  # the second call only prints the results
        grown = advdiff(*words, "--defect", "localisation:3.5", "--defect", "late", *more, cwd=tmp_path)
        assert grown.code == 0, grown.err
        assert "the file of mine:Mine has changed since this was begun" in grown.err
        said.append(grown.out)
    assert "; 4 to do" in said[0]  # finished episodes are kept
    both = _detections(tmp_path / "seen")
    assert list(both) == ["localisation:3.5", "late:strong"]
    assert both["localisation:3.5"]["failures"] == row["failures"]
    bench = advdiff(
        *("bench", "defects", "--targets", "mine:Mine", "--policies", "sumo", "--scenes", str(scenes)),
        *("--defects", "localisation:3.5,late", *more[:4], "--out", "bench"),
        cwd=tmp_path,
        hash_seed=1,
    )
    assert bench.code == 0, bench.err
    for name in ("detections.csv", "table.csv", "differences.csv", "table.json"):
        assert (tmp_path / "bench" / name).read_bytes() == (tmp_path / "seen" / name).read_bytes(), name
    assert (tmp_path / "bench" / "table.png").stat().st_size > 0
    (cost,) = csv.DictReader((tmp_path / "bench" / "first_detection.csv").read_text().splitlines())
    assert float(cost["all_cpu_s"]) > 0.0
    text = (tmp_path / "bench" / "findings.csv").read_text()
    worth = {row["target"]: row for row in csv.DictReader(text.splitlines())}
    assert list(worth) == ["careful", "mine:Mine"]
    mine = worth["mine:Mine"]
    assert 0 < int(mine["valid"]) <= int(mine["collisions"]) <= int(mine["episodes"]) == 3 * 4


@pytest.mark.slow
def test_failed_episodes_are_named_and_run_again(scenes: Path, tmp_path: Path) -> None:
    planner = tmp_path / "mine.py"
    planner.write_text(
        "from advdiff_sumo.planners.lane_graph import LaneGraphPlanner\n"
        "from pathlib import Path\n\n\n"
        "class Mine(LaneGraphPlanner):\n"
        "    def plan(self, road, scene, memory, rng):\n"
        "        if not (Path(__file__).parent / 'licensed').exists():\n"
        "            raise RuntimeError('no licence')\n"
        "        return super().plan(road, scene, memory, rng)\n"
    )
    words = ("defects", "--target", "mine:Mine", "--background", "sumo", "--scenes", str(scenes))
    more = ("--defect", "localisation:3.5", "--horizon", "5", "--workers", "1", "--out", "seen")
    first = advdiff(*words, *more, cwd=tmp_path)
    assert first.code == 0, first.err
    told = " ".join(first.out.split())
    assert "8 of sumo against mine:Mine (planner_error); run them again with --retry-failed" in told
    (tmp_path / "licensed").touch()
    printed = advdiff(*words, *more, cwd=tmp_path)
    assert "run them again" in " ".join(printed.out.split())  # the table is finished
    again = advdiff(*words, *more, "--retry-failed", cwd=tmp_path)
    assert again.code == 0, again.err
    assert "12 episodes in 3 cells; 8 to do" in again.out
    assert "--retry-failed" not in again.out
    assert _detections(tmp_path / "seen")["localisation:3.5"]["scenes"] == "4"


@pytest.mark.slow
def test_a_users_own_net_is_used_and_too_few_scenes_are_reported(grid: Path, tmp_path: Path) -> None:
    words = ("defects", "--net", str(grid), "--background", "scripted", "--licence", "lawful", *TINY)
    more = ("--set", "background_options.attack=hard-stop", "--workers", "1")
    one = (*words, *more, "--defect", "localisation:3.5")
    first = advdiff(*one, "--scenes", "2", cwd=tmp_path)
    assert first.code == 0, first.err
    few = "2 seed scenes are too few to detect the defect planted in lane_graph"
    assert first.out.count(few) == 1  # printed before the first episode, and not again below the table
    assert first.out.index(few) < first.out.index("6 episodes in 3 cells")
    folder = tmp_path / "runs" / "defects-lane_graph-grid"
    assert few in (folder / "table.md").read_text()
    assert f"Seed scenes: the first 2 of {grid}, seed 0." in first.out
    told = advdiff(*one, "--scenes", "2", "--json", cwd=tmp_path)
    assert (told.code, told.err) == (0, "")
    found = json.loads(told.out)
    (defect,) = found["defects"]
    row = _detections(folder)["localisation:3.5"]
    assert defect["detected"] is False
    assert {name: str(defect[name]) for name in ("scenes", "failures", "sound_failures")} == {
        name: row[name] for name in ("scenes", "failures", "sound_failures")
    }
    assert defect["p"] == float(row["p"])
    assert (defect["detected_by_rules"], row["detected_by_rules"]) == (False, "false")
    assert (str(defect["broke_rule"]), str(defect["sound_broke_rule"])) == (
        row["broke_rule"],
        row["sound_broke_rule"],
    )
    assert (found["folder"], found["detected"], found["planted"]) == (str(folder), 0, 1)
    assert [(x["background"], x["target"], x["scenes"]) for x in found["sound"]] == [
        ("scripted", "careful", 2),
        ("scripted", "lane_graph", 2),
    ]
    assert any(note.startswith(few) for note in found["notes"])
    grown = advdiff(*one, "--scenes", "3", cwd=tmp_path)
    assert "9 episodes in 3 cells; 3 to do" in grown.out
    refused = advdiff("defects", "--scenes", "list.json", "--out", str(folder), cwd=tmp_path)
    assert (refused.code, refused.err.count("\n")) == (2, 1)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ("--net", "motorway", "--scenes", "list.json"),
            "--scenes list.json: has its own nets; give the number",
        ),
        (("--net", "nowhere.net.xml"), "no such net"),
        (("--set", "scene.warmup_s=9"), "--set scene: a list has its own; add --net"),
        (("--defect", "laet"), "unknown defect 'laet'; did you mean 'late'?"),
        (("--severity", "stronk"), "severity = 'stronk'"),
        (("--background", "smuo"), "unknown background 'smuo'; did you mean 'sumo'?"),
        (("--target", "lane_grpah"), "unknown target 'lane_grpah'; did you mean 'lane_graph'?"),
        (("--target", "IDM", "--defect", "range"), "defect 'range' has no form for target 'IDM'"),
        (("--target", ""), "--target is empty"),
        (("--scenes", "301"), "--scenes 301: the list has 300"),
    ],
)
def test_unusable_options_of_defects_are_refused(
    words: tuple[str, ...], said: str, here: Callable[..., Outcome]
) -> None:
    done = here("defects", *words, "--out", "out")
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert said in done.err


def _detections(folder: Path) -> dict[str, dict[str, str]]:
    rows = csv.DictReader((folder / "detections.csv").read_text().splitlines())
    return {row["defect"]: row for row in rows}


@pytest.mark.slow
def test_a_sweep_varies_defects_and_refuses_those_it_does_not_know(tmp_path: Path) -> None:
    text = (
        "episodes = 1\nhorizon_s = 3\n[scene]\nwarmup_s = 10\nscenes_per_warmup = 1\nmin_neighbours = 1\n[sim]\n"
        'record_natural = false\n[grid]\nnets = ["motorway"]\nbackgrounds = ["sumo"]\n[[grid.targets]]\n'
        'name = "lane_graph"\n[grid.targets.vary]\ndefects = [[], ["localisation:3"], ["late:weak", "DEFECT"]]\n'
    )
    (tmp_path / "good.toml").write_text(text.replace("DEFECT", "range:9m"))
    done = advdiff("sweep", "good.toml", "--workers", "1", "--no-report", "--out", "swept", cwd=tmp_path)
    assert done.code == 0, done.err
    rows = pq.read_table(tmp_path / "swept" / "episodes.parquet").to_pylist()
    assert [row["target_options"] for row in rows] == [
        '{"defects":[]}',
        '{"defects":["localisation:3"]}',
        '{"defects":["late:weak","range:9m"]}',
    ]
    assert len({row["scene_key"] for row in rows}) == 1
    (tmp_path / "bad.toml").write_text(text.replace("DEFECT", "rnage:9"))
    refused = advdiff("sweep", "bad.toml", "--out", "none", cwd=tmp_path)
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "unknown defect 'rnage'; did you mean 'range'?" in refused.err
