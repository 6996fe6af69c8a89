"""``advdiff-sumo run`` on the shipped downtown: files, columns, and repeatability."""

from __future__ import annotations

import itertools
import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from advdiff_sumo.sim.run_store import TABLES
from tests.e2e.commands import TINY, Outcome, advdiff, bytes_of
from tests.e2e.conftest import sentence

ARROW = {"str": "string", "int64": "int64", "float64": "double", "bool": "bool"}


def test_the_folder_has_the_documented_files(downtown_run: Path) -> None:
    names = {path.name for path in downtown_run.iterdir()}
    assert names == {"run.toml", "report.html", *(f"{table}.parquet" for table in TABLES)}


@pytest.mark.parametrize("name", TABLES)
def test_columns_are_the_documented_ones(downtown_run: Path, name: str) -> None:
    table = pq.read_table(downtown_run / f"{name}.parquet")
    documented = {column: ARROW[about.dtype] for column, about in TABLES[name].items()}
    assert dict(zip(table.column_names, map(str, table.schema.types), strict=True)) == documented
    for column, about in TABLES[name].items():
        assert about.nullable or table[column].null_count == 0, column
        if about.dtype == "float64":
            assert pc.sum(pc.is_nan(table[column])).as_py() in (0, None), column


def test_tables_agree_with_each_other(downtown_run: Path) -> None:
    episodes = pq.read_table(downtown_run / "episodes.parquet").to_pylist()
    states = pq.read_table(downtown_run / "states.parquet").to_pylist()
    assert [row["episode"] for row in episodes] == [0, 1]
    for row in episodes:
        own = [s for s in states if s["episode"] == row["episode"]]
        target = [s for s in own if s["is_target"]]
        assert [s["step"] for s in target] == list(range(len(target)))
        assert target[0]["time_s"] == 0.0
        assert target[-1]["time_s"] == pytest.approx(row["duration_s"], abs=0.11)
        assert len({s["agent"] for s in own}) == row["agents"]
        assert len({s["agent"] for s in target}) == 1
        assert row["end"] in {"horizon", "collision", "arrived"}
        driven = sum(
            ((b["x_m"] - a["x_m"]) ** 2 + (b["y_m"] - a["y_m"]) ** 2) ** 0.5
            for a, b in itertools.pairwise(target)
        )
        assert driven == pytest.approx(row["distance_m"], abs=0.5)


def test_the_summary_names_the_folder(downtown_run: Path) -> None:
    said = (downtown_run.parent / "said.txt").read_text()
    assert "2 episodes" in said
    assert "target collides" in said
    assert "first/report.html" in said


def test_options_and_versions_are_written_down(downtown_run: Path) -> None:
    settings = tomllib.loads((downtown_run / "run.toml").read_text())
    assert settings["options"]["scene"]["warmup_s"] == 10.0
    assert (settings["options"]["net"], settings["options"]["horizon_s"]) == ("downtown", 4.0)
    assert settings["run"]["advdiff_sumo"]
    assert settings["run"]["libsumo"]


def test_run_toml_gives_the_same_bytes_in_another_process(downtown_run: Path) -> None:
    again = downtown_run.parent / "again"
    done = advdiff("run", "--config", "first/run.toml", "--out", again, cwd=again.parent, hash_seed=1)
    assert done.code == 0, done.err
    assert bytes_of(again) == bytes_of(downtown_run)
    assert (again / "run.toml").read_bytes() == (downtown_run / "run.toml").read_bytes()


def test_another_seed_is_another_run(here: Callable[..., Outcome], workplace: Path) -> None:
    words = ("run", "--net", "grid.net.xml", "--episodes", 1, *TINY)
    for seed, out in ((1, "one"), (2, "two")):
        assert here(*words, "--seed", seed, "--out", out).code == 0
    one, two = (bytes_of(workplace / name) for name in ("one", "two"))
    assert one["states.parquet"] != two["states.parquet"]
    assert one["episodes.parquet"] != two["episodes.parquet"]


def test_results_of_a_run_are_those_of_a_sweep_of_one_cell(
    downtown_run: Path, here: Callable[..., Outcome], tmp_path: Path
) -> None:
    asked = "select key, target, background, net, target_collision, junction_type is null from episodes"
    told = here("results", downtown_run, "--sql", asked, "--format", "json")
    assert told.code == 0, told.err
    rows = json.loads(told.out)
    assert [row["key"] for row in rows] == ["000000", "000001"]
    assert {(row["target"], row["background"], row["net"]) for row in rows} == {("IDM", "sumo", "downtown")}
    assert not any(row["(junction_type IS NULL)"] for row in rows)
    junit = tmp_path / "junit.xml"
    done = here("results", downtown_run, "--junit", junit, "--fail-if", "episodes == 2")
    assert done.code == 1
    assert "2 episodes; rates" in done.out
    assert "2 worst episodes" in done.out
    assert "--fail-if episodes == 2: episodes = 2" in " ".join(done.out.split())
    assert 'name="advdiff-sumo" tests="3" failures="1"' in junit.read_text()
    none = here("results", downtown_run, "--sql", "select count(*) n from failures", "--format", "json")
    assert json.loads(none.out) == [{"n": 0}]


@pytest.mark.parametrize("gate", [("--fail-if", "episodes == 2"), ("--junit", "junit.xml")])
def test_fail_if_is_refused_with_a_query(
    downtown_run: Path, here: Callable[..., Outcome], workplace: Path, gate: tuple[str, str]
) -> None:
    said = sentence(here("results", downtown_run, "--sql", "select 1", *gate))
    assert said == "error: --fail-if and --junit go without --sql; give two commands"
    assert not (workplace / "junit.xml").exists()


def test_a_format_is_refused_without_a_query(downtown_run: Path, here: Callable[..., Outcome]) -> None:
    done = here("results", downtown_run, "--format", "csv")
    assert sentence(done) == "error: --format csv is of the answer to --sql; add that"
    assert not done.out


def test_runs_are_compared_by_their_seed_scenes(downtown_run: Path, here: Callable[..., Outcome]) -> None:
    done = here("compare", downtown_run, downtown_run)
    assert done.code == 0, done.err
    assert "2 pairs of episodes from 2 seed scenes" in done.out
    assert f"A: {downtown_run}\nB: {downtown_run}\n" in done.out
    gate = ("compare", downtown_run, downtown_run, "--fail-if")
    assert here(*gate, "valid_failure_rate_only_b > 0 or collision_rate_change > 0").code == 0
    met = here(*gate, "pairs < 3 and collision_rate_p == 1")
    assert (met.code, "collision_rate_p = 1, pairs = 2" in " ".join(met.out.split())) == (1, True)
    assert "no figure 'valid_failure_rate'; " in sentence(here(*gate, "valid_failure_rate > 0"))
    alone = here(
        "compare", downtown_run, downtown_run, "--a", "episode=0", *gate[3:], "collision_rate_only_b > 0"
    )
    assert (alone.code, 'counterpart, which --fail-if does not ask about; add "or unpaired' in alone.err) == (
        0,
        True,
    )
    assert (
        "1 episode failed or without a finished counterpart: 0 of A (0 failed), 1 of B (0 failed)\n"
        in alone.out
    )
    told = json.loads(here("compare", downtown_run, downtown_run, "--json").out)
    assert (told["pairs"], told["episodes_alone"]["collisions"]) == (2, {"a": [], "b": []})


def test_a_run_whose_net_has_changed_has_no_results(here: Callable[..., Outcome], workplace: Path) -> None:
    assert here("run", "--net", "grid.net.xml", "--episodes", 1, *TINY, "--out", "one").code == 0
    net = workplace / "grid.net.xml"
    net.write_text(net.read_text().replace('speed="13.89"', 'speed="13.88"'))
    assert "is not what it was when that run was begun" in sentence(here("results", "one"))
    judged = here("verdict", "one")
    assert (judged.code, "judged on the nets that are there now" in judged.out.replace("\n", " ")) == (
        0,
        True,
    )
