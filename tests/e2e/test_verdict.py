"""``advdiff-sumo verdict`` on runs of this and of an earlier version, and on folders that are no runs."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from advdiff_sumo.metrics.columns import LATER_COLUMNS
from tests.e2e.commands import Outcome
from tests.metrics.encounter_folder import encounter_folder

TOOL = Path(__file__).resolve().parents[2] / "tools" / "check_verdicts.py"


@pytest.fixture
def collided(tmp_path: Path) -> Path:
    """Return a run folder of invented episodes on a small net."""
    return encounter_folder(tmp_path)


def table(folder: Path, name: str = "episodes") -> list[dict]:
    return pq.read_table(folder / f"{name}.parquet").to_pylist()


def make_older(folder: Path, *, signals: bool) -> None:
    """Remove the columns and tables that earlier versions did not write."""
    for name in ("episodes", "collisions"):
        path = folder / f"{name}.parquet"
        whole = pq.read_table(path)
        pq.write_table(whole.drop_columns([c for c in whole.column_names if c in LATER_COLUMNS]), path)
    if not signals:
        (folder / "signals.parquet").unlink()


@pytest.mark.slow
def test_the_same_verdicts_again(collided: Path, here: Callable[..., Outcome]) -> None:
    before = table(collided), table(collided, "collisions")
    assert [row["valid_failure"] for row in before[0]] == [True, False, False]
    assert [row["critical"] for row in before[0]] == [False, False, True]
    done = here("verdict", collided, "--workers", "2")
    assert done.code == 0, done.err
    assert "2 collisions of the target: 1 valid failure\n" in done.out
    assert (table(collided), table(collided, "collisions")) == before
    told = json.loads(here("verdict", collided, "--workers", "1", "--json").out)
    assert (told["episodes"], told["valid_failures"], told["collisions"]) == (3, 1, 2)


@pytest.mark.slow
def test_the_search_says_what_is_unavoidable(collided: Path, here: Callable[..., Outcome]) -> None:
    """Both collisions can be avoided in time; results of the search are kept, and contradict no verdict."""
    unsearched = check_verdicts(collided)
    assert unsearched.returncode == 2
    assert "nothing was searched" in unsearched.stderr
    assert [row["solvable"] for row in table(collided)] == [None, None, None]
    done = here("verdict", collided, "--search", "--workers", "1")
    assert done.code == 0, done.err
    assert "0 unavoidable" in done.out
    searched = table(collided)
    assert [(row["solvable"], row["unavoidable"]) for row in searched] == [(True, False)] * 2 + [(None, None)]
    assert here("verdict", collided, "--workers", "1").code == 0
    assert table(collided) == searched
    checked = check_verdicts(collided)
    assert checked.returncode == 0, checked.stderr
    assert checked.stdout.splitlines()[0] == "2 collisions of the target"
    assert "0 contradictions" in checked.stdout
    contradict(collided)
    checked = check_verdicts(collided, "--differences")
    assert checked.returncode == 1
    assert "episode 0, lead, by CC_human_driver" in checked.stdout


def check_verdicts(*arguments: Path | str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, TOOL, *arguments], check=False, capture_output=True, text=True)


def contradict(folder: Path) -> None:
    """Mark every collision as not avoided by any drive of the search."""
    path = folder / "collisions.parquet"
    whole = pq.read_table(path)
    column = whole.column_names.index("solvable")
    pq.write_table(whole.set_column(column, "solvable", pa.array([False] * whole.num_rows)), path)


def test_a_folder_of_an_earlier_version(collided: Path, here: Callable[..., Outcome]) -> None:
    before = table(collided)
    make_older(collided, signals=False)
    assert here("report", collided).code == 0
    done = here("verdict", collided, "--workers", "1")
    assert done.code == 0, done.err
    after = table(collided)
    for name in ("valid_failure", "preventable_by", "lawful", "other_breaches", "at_fault", "spare_m"):
        assert [row[name] for row in after] == [row[name] for row in before], name
    assert "Not judged: " in after[0]["verdict"]
    assert after[1]["verdict"].endswith("'north' entered the junction on red.")


def test_what_is_no_run_or_has_lost_its_net(collided: Path, here: Callable[..., Outcome]) -> None:
    nothing = here("verdict", collided.parent)
    assert nothing.code == 2
    assert "holds no run and no sweep" in nothing.err.replace("\n", " ")
    (collided.parent / "traffic_light.net.xml").unlink()
    lost = here("verdict", collided)
    assert lost.code == 2
    assert "is no longer there" in lost.err.replace("\n", " ")
    shutil.rmtree(collided)
    assert here("verdict", collided).code == 2


SWEEP = """
episodes = 2
horizon_s = 4.0
seeds = [3]
scene = { warmup_s = 8.0, scenes_per_warmup = 2, min_neighbours = 1 }

[grid]
nets = ["downtown"]
targets = ["IDM"]
backgrounds = ["sumo"]
"""


def test_a_sweep_and_one_of_an_earlier_version(tmp_path: Path, here: Callable[..., Outcome]) -> None:
    (tmp_path / "small.toml").write_text(SWEEP)
    assert here("sweep", tmp_path / "small.toml", "--out", tmp_path / "sweep", "--workers", "1").code == 0
    before = table(tmp_path / "sweep")
    assert here("verdict", tmp_path / "sweep", "--workers", "1").code == 0
    assert table(tmp_path / "sweep") == before
    assert here("results", tmp_path / "sweep", "--fail-if", "valid_failures > 0").code == 0
    make_older(tmp_path / "sweep", signals=True)
    settings = tmp_path / "sweep" / "sweep.toml"
    lines = [
        "keys = 'of old'" if line.startswith("keys") else line for line in settings.read_text().splitlines()
    ]
    settings.write_text("\n".join(lines))
    done = here("verdict", tmp_path / "sweep", "--workers", "1")
    assert done.code == 0, done.err
    assert "verdicts go into its tables alone, until" in done.out.replace("\n", " ")
    after = table(tmp_path / "sweep")
    assert [row["valid_failure"] for row in after] == [row["valid_failure"] for row in before]
    assert list(after[0]) == list(before[0])


def test_an_exported_scenario_and_one_of_others(collided: Path, here: Callable[..., Outcome]) -> None:
    """The encounter of episode 0 has the same verdict from each file; without names, the planning problem is used."""
    net, out = collided.parent / "traffic_light.net.xml", collided.parent / "files"
    assert here("export", collided, "--episode", "0", "-f", "commonroad", "-f", "csv", "--out", out).code == 0
    (commonroad,) = out.glob("*.cr.xml")
    judged = [here("verdict", path, "--net", net) for path in (commonroad, *out.glob("*.csv"))]
    assert [done.code for done in judged] == [0, 0], judged[0].err
    for done in judged:
        assert done.out.startswith("run-0000, ego: rear_end_striking at ")
        assert "valid failure. A careful and competent driver" in done.out
        assert "the target ran into the rear of 'lead'" in done.out
    (told,) = json.loads(here("verdict", commonroad, "--net", net, "--json").out)["scenarios"]
    assert (told["scenario"], told["target"], told["collision_partner"]) == ("run-0000", "ego", "lead")
    assert (told["valid_failure"], told["target_breaches"]) == (True, "ran_into")
    assert (told["offences"], told["offences_text"]) == ("", None)
    nameless = out / "others.xml"
    nameless.write_text(re.sub("<!--.*?-->", "", commonroad.read_text()))
    done = here("verdict", nameless, "--net", net)
    assert done.code == 0, done.err
    assert "rear_end_striking" in done.out
    names = re.findall(r'<dynamicObstacle id="(\d+)"', nameless.read_text())
    others = [here("verdict", nameless, "--net", net, "--target", name).out for name in names]
    assert sorted("rear_end_struck" in text for text in others) == [False, True]


def test_a_scenario_that_cannot_be_judged(collided: Path, here: Callable[..., Outcome]) -> None:
    net, out = collided.parent / "traffic_light.net.xml", collided.parent / "files"
    assert here("export", collided, "--episode", "0", "-f", "csv", "--out", out).code == 0
    (path,) = out.glob("*.csv")
    refused = {
        "has no road user 'eco'; did you mean 'ego'?": (path, "--net", net, "--target", "eco"),
        "is off the road of": (path, "--net", "motorway"),
        "no such net": (path, "--net", "nowhere.net.xml"),
        "no such log": (out / "none.xml", "--net", net),
        "--target is for scenarios": (collided, "--target", "ego"),
        "or --net with a scenario": (out,),
    }
    for sentence, arguments in refused.items():
        done = here("verdict", *arguments)
        assert done.code == 2, sentence
        assert sentence in " ".join(done.err.split())
