"""Sweep files: what they request, and errors in one sentence."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from advdiff_sumo.core.errors import ConfigError, InputError
from advdiff_sumo.sweep.job_plan import plan_sweep
from advdiff_sumo.sweep.spec import SweepSpec
from tests.sweep.conftest import values

SWEEPS = sorted((Path(__file__).parents[2] / "scenarios" / "sweeps").glob("*.toml"))
GRID = {"targets": ["IDM"], "backgrounds": ["sumo"]}


def test_a_grid_is_every_combination() -> None:
    grid = {
        "nets": ["downtown", {"net": "motorway"}],
        "targets": ["IDM", {"name": "W99", "options": {"tau": 1.0}, "vary": {"minGap": [1.0, 2.0, 3.0]}}],
        "backgrounds": ["sumo", "replay"],
    }
    cells = list(SweepSpec.of({"grid": grid, "seeds": [3, 5], "episodes": 7}, "x").cells())
    assert len(cells) == 2 * 2 * (1 + 3) * 2
    first, second, *_, last = cells
    assert (first.net, first.seed, first.target, first.background) == ("downtown", 3, "IDM", "sumo")
    assert (second.target, second.background) == ("IDM", "replay")
    assert (last.net, last.seed, last.target_options) == ("motorway", 5, {"tau": 1.0, "minGap": 3.0})
    assert {cell.episodes for cell in cells} == {7}


def test_a_grid_of_situations() -> None:
    """Net by net, situation by situation; the other options of the seed scenes are those of all."""
    grid = {**GRID, "nets": ["downtown", "motorway"], "situations": ["any", "merging"]}
    cells = list(SweepSpec.of({"grid": grid, "scene": {"density_per_km": 9.0}}, "x").cells())
    assert [(cell.net, cell.scene.situation) for cell in cells] == [
        *(("downtown", "any"), ("downtown", "merging"), ("motorway", "any"), ("motorway", "merging")),
    ]
    assert {cell.scene.density_per_km for cell in cells} == {9.0}


def test_a_list_is_taken_as_it_is() -> None:
    cases = [{"target": "ACC"}, {"target": "ACC", "seed": 9, "episodes": 3}]
    cells = list(SweepSpec.of({"cases": cases, "seeds": [0, 1]}, "x").cells())
    assert [(cell.seed, cell.episodes) for cell in cells] == [(0, 10), (1, 10), (9, 3)]


def test_a_case_may_have_scenes_of_its_own() -> None:
    cases = [{"target": "ACC"}, {"target": "ACC", "scene": {"situation": "turning"}}]
    one, other = SweepSpec.of({"cases": cases, "scene": {"density_per_km": 9.0}}, "x").cells()
    assert (one.scene.situation, other.scene.situation) == ("any", "turning")
    assert {one.scene.density_per_km, other.scene.density_per_km} == {9.0}


def test_other_targets_take_the_place_of_those_named() -> None:
    """Each once, with default options; cases that differ in their targets only become one."""
    grid = {"targets": [{"name": "W99", "vary": {"tau": [1.0, 2.0]}}, "IDM"], "backgrounds": ["sumo"]}
    cases = [
        {"target": "ACC", "target_options": {"tau": 1.5}},
        {"target": "IDM"},
        {"target": "IDM", "seed": 4},
    ]
    spec = SweepSpec.of({"grid": grid, "cases": cases}, "x").with_targets(["careful", "Krauss", "careful"])
    assert [(cell.target, cell.target_options, cell.seed) for cell in spec.cells()] == [
        *(("careful", {}, 0), ("Krauss", {}, 0)),
        *(("careful", {}, 0), ("Krauss", {}, 0)),
        *(("careful", {}, 4), ("Krauss", {}, 4)),
    ]
    assert SweepSpec.of({"cases": cases}, "x").with_targets(["Krauss"]).grid is None


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            {"cases": [{"scene": {"situatoin": "turning"}}]},
            ("x.toml: cases.0.scene: no option 'situatoin'", "did you mean 'situation'"),
        ),
        (
            {"cases": [{}, {"scene": {"warmup_s": 1}}]},
            ("x.toml: cases.1.scene: warmup_s = 1: input should be greater than or equal to 5",),
        ),
        (
            {"cases": [{}, {"horizon_s": -3}]},
            (
                "no option 'cases.1.horizon_s'; 'horizon_s' holds for the whole file: write it above its first [table]",
            ),
        ),
        (
            {"cases": [{}], "horizon_s": 0.01},
            ("x.toml: cases.0: horizon_s = 0.01 is shorter than a step; give at least sim.step_s, 0.1",),
        ),
        ({"grid": GRID, "episods": 3}, ("x.toml: no option 'episods'", "did you mean 'episodes'")),
        ({"grid": {**GRID, "target": []}}, ("no option 'grid.target'", "did you mean 'targets'")),
        ({"grid": {**GRID, "background": []}}, ("no option 'grid.background'", "did you mean 'backgrounds'")),
        ({"grid": GRID, "seeds": [0, 2**63]}, (f"seeds.1 = {2**63}", "less than")),
        ({"grid": GRID, "seeds": [-1]}, ("seeds.0 = -1", "greater than or equal to 0")),
        ({"cases": [{"seed": 10**20}]}, ("cases.0.seed", "less than")),
        ({"grid": {**GRID, "targets": [{"nme": "IDM"}]}}, ("grid.targets.0", "name")),
        ({"grid": {**GRID, "targets": []}}, ("the grid is empty", "grid.targets")),
        ({"grid": {**GRID, "nets": []}}, ("the grid is empty", "grid.nets")),
        ({"grid": {**GRID, "backgrounds": []}}, ("the grid is empty", "grid.backgrounds")),
        ({"grid": {**GRID, "situations": ["mergin"]}}, ("grid.situations.0", "merging")),
        (
            {"grid": {**GRID, "situations": ["merging"]}, "scene": {"situation": "turning"}},
            ("scene.situation stands beside grid.situations; leave one out",),
        ),
        ({"grid": {**GRID, "situations": ["any", "any"]}}, ("grid.situations names a situation twice",)),
        ({}, ("asks for no episode", "[grid]")),
        ({"grid": GRID, "seeds": []}, ("seeds is empty",)),
        ({"grid": GRID, "episodes": 0}, ("episodes = 0", "greater than or equal to 1")),
        (
            {"grid": {**GRID, "targets": [{"name": "IDM", "vary": {"tau": [1.0, math.nan]}}]}},
            ("grid.targets.0.vary: tau = (1.0, nan): give finite numbers",),
        ),
        (
            {"grid": {**GRID, "backgrounds": [{"name": "sumo", "options": {"a": math.inf}}]}},
            ("grid.backgrounds.0.options: a = inf: give finite numbers",),
        ),
        ({"cases": [{"target_options": {"tau": -math.inf}}]}, ("cases.0.target_options: tau = -inf",)),
        ({"grid": {**GRID, "targets": [{"name": "IDM", "vary": {"tau": []}}]}}, ("vary.tau is empty",)),
        (
            {"grid": {**GRID, "targets": [{"name": "IDM", "options": {"tau": 1.0}, "vary": {"tau": [2.0]}}]}},
            ("'tau' stands in options and in vary",),
        ),
    ],
)
def test_a_wrong_file_is_one_sentence(content: dict[str, Any], words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError) as caught:
        SweepSpec.of(content, "x.toml")
    said = str(caught.value)
    assert said.startswith("x.toml: ")
    assert "\n" not in said
    for word in words:
        assert word in said


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        ({"targets": ["Kraus"]}, ("unknown target 'Kraus'", "did you mean 'Krauss'")),
        ({"backgrounds": ["replays"]}, ("unknown background 'replays'", "did you mean 'replay'")),
        ({"nets": ["nowhere.net.xml"]}, ("nowhere.net.xml: no such net", "downtown")),
        ({"targets": [{"name": "IDM", "options": {"taau": 1.0}}]}, ("taau", "tau")),
        ({"targets": ["IDM", "idm"]}, ("two entries of the sweep are the same",)),
    ],
)
def test_a_wrong_name_is_one_sentence(place: Path, grid: dict[str, Any], words: tuple[str, ...]) -> None:
    content = values(place)
    content["grid"] = {**content["grid"], "targets": ["IDM"], **grid}
    with pytest.raises(InputError) as caught:
        plan_sweep(SweepSpec.of(content, "x.toml"))
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_a_wrong_option_in_a_case_is_refused_with_its_place(place: Path) -> None:
    content = values(place)
    net = content["grid"]["nets"][0]
    cases = [{"net": net}, {"net": net, "target": "lane_graph", "target_options": {"horizon_s": -3}}]
    spec = SweepSpec.of({**content, "grid": None, "cases": cases}, "x.toml")
    said = "options of target 'lane_graph': horizon_s = -3: input should be greater than or equal to 3"
    with pytest.raises(ConfigError, match=f"^cases.1: {said}"):
        plan_sweep(spec, places=True)
    with pytest.raises(ConfigError, match=f"^{said}"):
        plan_sweep(spec)


def test_the_file_of_a_run_is_no_sweep(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text("[run]\n[options]\nnet = 'downtown'\n")
    with pytest.raises(ConfigError, match="is the file of a run; repeat it with advdiff-sumo run --config"):
        SweepSpec.read(path)


def test_files_are_named_by_their_full_path(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place)
    content = values(place)
    content["grid"] = {**content["grid"], "nets": ["small.net.xml"]}
    (net,) = SweepSpec.of(content, "x").grid.nets  # type: ignore[union-attr] # there is a grid
    assert net.net == str(place / "small.net.xml")


@pytest.mark.parametrize("path", SWEEPS, ids=lambda path: path.stem)
def test_the_shipped_sweeps_are_sound(path: Path) -> None:
    plan = plan_sweep(SweepSpec.read(path))
    assert len({job.key for job in plan.jobs}) == len(plan.jobs) >= 20


def test_three_sweeps_are_shipped() -> None:
    assert {path.stem for path in SWEEPS} >= {"quick", "planners", "models"}
