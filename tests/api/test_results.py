"""The Python API: runs, their results, and their display in a notebook."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import advdiff_sumo as ads
from advdiff_sumo.core.errors import ConfigError, FileError, InputError
from advdiff_sumo.core.plan import Controls
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.report.run_summary import summary_figures, summary_lines
from advdiff_sumo.sweep.sole_writer import sole_writer
from tests.e2e.commands import advdiff

SCENE = {"warmup_s": 10.0, "scenes_per_warmup": 2, "min_neighbours": 1}


class Accelerates:
    """A user's planner, which is given as an object."""

    def __init__(self, accel_mps2: float) -> None:
        self.accel_mps2 = accel_mps2

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> None:
        return None

    def plan(
        self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator
    ) -> tuple[Controls, None]:
        return Controls(np.full(10, self.accel_mps2), np.zeros(10), 0.1), memory


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> ads.Results:
    """Return two short episodes of a planner that is given as an object."""
    out = tmp_path_factory.mktemp("api") / "run"
    return ads.run(target=Accelerates(2.0), episodes=2, horizon_s=4.0, scene=SCENE, out=out, seed=1)


def test_the_planner_that_was_given_drives(results: ads.Results) -> None:
    states = results.table("states").to_pylist()
    for episode in results:
        own = [row for row in states if row["episode"] == episode.number and row["is_target"]]
        gained = own[10]["speed_mps"] - own[0]["speed_mps"]
        assert gained == pytest.approx(2.0, abs=0.05)  # 2 m/s² for a second
    assert f'target = "{__name__}:Accelerates"' in (results.folder / "run.toml").read_text()


def test_nobody_else_writes_into_the_folder_of_a_run(tmp_path: Path) -> None:
    tried, out = list[bool](), tmp_path / "run"

    class Resumes(Accelerates):
        def plan(
            self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator
        ) -> tuple[Controls, None]:
            with pytest.raises(FileError, match="another process is writing into it"), sole_writer(out):
                pass
            tried.append(True)
            return super().plan(road, scene, memory, rng)

    ads.run(target=Resumes(1.0), episodes=1, horizon_s=1.0, scene=SCENE, out=out)
    assert tried


@pytest.mark.slow
def test_a_name_gives_the_bytes_of_the_command(tmp_path: Path) -> None:
    ads.run(target="lane_graph", episodes=1, horizon_s=3.0, scene=SCENE, out=tmp_path / "api")
    words = ["run", "--target", "lane_graph", "--episodes", "1", "--horizon", "3", "--out", "cli"]
    settings = [word for key, value in SCENE.items() for word in ("--set", f"scene.{key}={value}")]
    assert advdiff(*words, *settings, cwd=tmp_path).code == 0
    for name in ("episodes", "states"):
        path = f"{name}.parquet"
        assert (tmp_path / "api" / path).read_bytes() == (tmp_path / "cli" / path).read_bytes()


def test_display_of_results(results: ads.Results) -> None:
    again = ads.load(results.folder)
    assert len(again) == again.episodes.num_rows == 2
    summary = again.summary()
    assert summary.figures["episodes"] == 2
    assert repr(summary).splitlines()[0].startswith("valid failures")
    assert "2 episodes" in repr(again)
    shown = again._repr_html_()
    assert shown.count("<tr>") == len(summary.lines)
    assert "data:image/png;base64," in shown
    episode = again.episode(1)
    assert episode.number == 1
    assert len(episode.figure(panels=3).axes) == 3
    for panels in (0, 9):
        with pytest.raises(ConfigError, match=f"panels={panels}: give a number from 1 to 8"):
            episode.figure(panels=panels)
    player = episode.player()._repr_html_()
    assert player.startswith("<iframe")
    assert "srcdoc=" in player
    assert again.report().path == results.folder / "report.html"


def test_missing_things_get_one_sentence(results: ads.Results, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="has no episode 7; it has 0 to 1"):
        results.episode(7)
    with pytest.raises(FileError, match="no such table; known are: collisions, episodes"):
        results.table("episode")
    with pytest.raises(FileError, match=r"run.toml: is missing; give the folder of a finished run"):
        ads.load(tmp_path / "nothing")
    with pytest.raises(ConfigError, match=r"ads.run: no option 'horizon'; did you mean 'horizon_s'"):
        ads.run(horizon=3.0)


class Lost:
    """A planner that raises in its first plan."""

    def start(self, road: object, scene: object, rng: object) -> None:
        return None

    def plan(self, road: object, scene: object, memory: None, rng: object) -> float:
        return 1.0 / 0.0


def test_a_planner_that_cannot_drive(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is the class Lost; give an object of it: Lost\(\)"):
        ads.run("downtown", Lost)
    with pytest.raises(InputError, match="target object has no method 'start'"):
        ads.run("downtown", object())
    lost = ads.run("downtown", Lost(), episodes=1, horizon_s=1.0, out=tmp_path / "lost", progress=False)
    assert "the first planner_error" in repr(lost.summary())
    assert "ZeroDivisionError" in repr(lost.summary())
    with pytest.raises(InputError, match=r"the episode failed before it began: .*ZeroDivisionError"):
        lost.episode(0).figure()
    for shown in (lost._repr_html_(), lost.worst()._repr_html_()):
        assert "failure_kind planner_error" in shown
        assert "<img" not in shown


def test_a_planner_object_takes_defects_and_no_other_option(tmp_path: Path) -> None:
    for options in ({"tau": 1.5}, {"accel_mps2": 1.0}, {"defects": [], "accel_mps2": 1.0}):
        with pytest.raises(
            ConfigError, match=r"comes too late .* as in target=Accelerates\(\w+=\.\.\.\), or give"
        ):
            ads.run(target=Accelerates(2.0), target_options=options, out=tmp_path / "none")
    with pytest.raises(ConfigError, match="defect 'late' has no severity 'huge'"):
        ads.run(target=Accelerates(2.0), target_options={"defects": "late:huge"}, out=tmp_path / "none")
    assert not (tmp_path / "none").exists()
    options = {"defects": ["weak-brakes:2"]}
    brakes = ads.run(
        target=Accelerates(-5.0),
        target_options=options,
        episodes=1,
        horizon_s=1.0,
        scene={**SCENE, "min_speed_mps": 5.0},
        out=tmp_path / "weak",
        progress=False,
    )
    own = [row["speed_mps"] for row in brakes.table("states").to_pylist() if row["is_target"]]
    assert own[0] - own[10] == pytest.approx(2.0, abs=0.05)
    written = (brakes.folder / "run.toml").read_text()
    assert f'target = "{__name__}:Accelerates"' in written
    assert "weak-brakes:2" in written


def test_figures_by_hand() -> None:
    done = {
        "end": "horizon",
        "target_collision": False,
        "route_completed": True,
        "critical": False,
        "offences": "",
        "failure_kind": None,
    }
    rows = [
        {**done, "min_ttc_s": 2.0, "min_clearance_m": 1.0, "at_fault": None, "valid": None},
        {
            **done,
            "offences": "speeding",
            "min_ttc_s": 4.0,
            "min_clearance_m": None,
            "at_fault": None,
            "valid": None,
        },
        {"end": "failed", "failure_kind": "planner_error", "target_collision": False},
    ]
    figures = summary_figures(rows)
    assert (figures["episodes"], figures["finished"], figures["collisions"]) == (3, 2, 0)
    assert figures["failed"] == {"planner_error": 1}
    assert (figures["median_min_ttc_s"], figures["median_min_clearance_m"]) == (3.0, 1.0)
    lines = dict(summary_lines(rows, []))
    assert figures["offences"] == 1
    assert lines["target breaks a rule"].endswith("1 of 2")
    assert lines["failed episodes"].endswith("1 of 3")
    assert lines["median of minimum TTC"] == "3.00 s"
    assert lines["median of minimum clearance"] == "1.00 m (of 1 of 2 episodes)"


def test_a_sweep(tmp_path: Path) -> None:
    grid = {"nets": ["downtown"], "targets": ["IDM", "Krauss"], "backgrounds": ["sumo"]}
    spec = {"episodes": 1, "horizon_s": 2.0, "scene": SCENE, "grid": grid}
    swept = ads.sweep(spec, out=tmp_path / "s", workers=1)
    assert [row["target"] for row in swept.episodes.to_pylist()] == ["IDM", "Krauss"]
    assert swept.worst().figure().axes


def test_the_import_loads_no_large_library() -> None:
    code = (
        "import sys, advdiff_sumo; "
        "print({'numpy', 'torch', 'matplotlib', 'pyarrow', 'libsumo', 'shapely'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_names_that_the_package_lacks() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'runn'"):
        _ = ads.runn  # type: ignore[attr-defined]  # this is what the test checks
    assert {"run", "sweep", "load", "convert"} <= set(dir(ads))
