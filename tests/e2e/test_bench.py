"""``bench`` as a user types it: small tables, continuing after a kill, printing finished tables, and refusals."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from advdiff_sumo.experiments.bench.scene_list import make_list, write_scene_list
from advdiff_sumo.sim.sim_options import SceneOptions
from tests.e2e.commands import Outcome, advdiff, begin
from tests.hang_guard import HANG_S

STEADY = ("table.csv", "differences.csv", "table.json")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a list of four seed scenes, two from each of two warm-ups."""
    return _scene_list(tmp_path_factory.mktemp("scenes") / "four.json", 4)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a list of two seed scenes of one warm-up."""
    return _scene_list(tmp_path_factory.mktemp("scenes") / "two.json", 2)


def _scene_list(path: Path, count: int) -> Path:
    scene = SceneOptions(warmup_s=8.0, scenes_per_warmup=2, spacing_s=2.0, min_neighbours=1)
    write_scene_list(path, make_list(count, 5, "a test", ("motorway",), scene))
    return path


def words(scenes: Path, out: str, targets: str = "IDM") -> tuple[str, ...]:
    named = ("--scenes", str(scenes), "--policies", "sumo,replay,unguided", "--targets", targets)
    return ("bench", "adversarial", *named, "--horizon", "3", "--workers", "2", "--out", out)


@pytest.mark.slow
def test_a_bench_that_was_killed_goes_on_and_ends_with_the_same_bytes(scenes: Path, tmp_path: Path) -> None:
    whole = advdiff(*words(scenes, "whole"), cwd=tmp_path)
    assert whole.code == 0, whole.err
    assert "12 episodes in 3 cells; 12 to do" in whole.out
    first = begin(*words(scenes, "broken"), cwd=tmp_path, hash_seed=2)
    _wait_for(tmp_path / "broken" / "sweep" / "episodes", 3)
    first.kill()
    first.communicate(timeout=HANG_S)
    done = advdiff(*words(scenes, "broken"), cwd=tmp_path, hash_seed=1)
    assert done.code == 0, done.err
    for name in STEADY:
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "broken" / name).read_bytes(), name
    rows = list(csv.DictReader((tmp_path / "whole" / "table.csv").read_text().splitlines()))
    rates = {row["row"]: row for row in rows if row["column"] == "collision_rate"}
    assert set(rates) == {"SUMO (natural)", "Replay", "diffusion, unguided"}
    assert all(row["n"] == "4" and row["low"] and row["high"] for row in rates.values())
    assert {row["column"] for row in rows} >= {"jsd", "veh_rate", "nats", "accel_mps2"}

    printed = advdiff(
        "bench", "adversarial", "--out", "whole", cwd=tmp_path
    )  # the request is stored in the folder
    assert printed.code == 0, printed.err
    assert "to do" not in printed.out
    assert "Adversarial traffic, closed loop: 4 seed scenes, 3 s" in printed.out
    wrong = advdiff("bench", "transfer", "--out", "whole", cwd=tmp_path)
    assert (wrong.code, wrong.err.count("\n")) == (2, 1)
    assert "belongs to bench adversarial; choose another --out" in wrong.err


SHORT = ("--horizon", "3", "--workers", "2")


@pytest.mark.slow
def test_fewshot_and_transfer(pair: Path, tmp_path: Path) -> None:
    small = ("--scenes", pair, *SHORT)
    done = advdiff(
        "bench",
        "fewshot",
        *small,
        "--targets",
        "EIDM",
        "--seeds",
        "2",
        "--steps",
        "2",
        "--out",
        "few",
        cwd=tmp_path,
    )
    assert done.code == 0, done.err
    rows = list(csv.DictReader((tmp_path / "few" / "table.csv").read_text().splitlines()))
    ladder = [("steps_0", "2"), ("steps_1", "4"), ("steps_2", "4")]
    assert [(row["target"], row["row"], row["column"], row["n"]) for row in rows] == [
        (f"guided by {guide}", "EIDM", *step)
        for guide in ("Q alone", "Q and the attack's terms")
        for step in ladder
    ]
    done = advdiff(
        *("bench", "transfer", *small, "--policies", "diffusion", "--targets", "lane_graph,IDM"),
        *("--steps", "4", "--out", "over"),
        cwd=tmp_path,
    )
    assert done.code == 0, done.err
    rows = list(csv.DictReader((tmp_path / "over" / "table.csv").read_text().splitlines()))
    assert {row["column"] for row in rows} == {
        f"{t}:{c}" for t in ("lane_graph", "IDM") for c in ("av_rate", "bv_rate")
    }


@pytest.mark.nightly
@pytest.mark.slow
def test_transfer_under_a_licence(pair: Path, tmp_path: Path) -> None:
    lawful = advdiff(
        *("bench", "transfer", "--scenes", pair, *SHORT, "--policies", "diffusion", "--targets", "IDM"),
        *("--steps", "4", "--licence", "lawful", "--out", "lawful"),
        cwd=tmp_path,
    )
    assert lawful.code == 0, lawful.err
    assert "Licence: lawful." in lawful.out


@pytest.mark.data
def test_a_bench_from_a_driving_log(adv_data: Path, tmp_path: Path) -> None:
    log = adv_data / "commonroad" / "USA_Lanker-1_3_T-1.xml.gz"
    done = advdiff(
        *("bench", "adversarial", "--scenes", str(log), "--policies", "sumo,replay", "--targets", "IDM"),
        *("--horizon", "1", "--workers", "1", "--out", "log"),
        cwd=tmp_path,
    )
    assert done.code == 0, done.err
    assert "Seed scenes are of a driving log, one a second of every drive." in done.out
    assert (tmp_path / "log" / "nets" / "USA_Lanker-1_3_T-1.net.xml").is_file()


@pytest.mark.slow
def test_traffic_on_windows_of_its_own(tmp_path: Path) -> None:
    made = advdiff(
        "data",
        "simulate",
        "--net",
        "motorway",
        "--random-share",
        "0",
        "--windows",
        "12",
        "--out",
        "w",
        cwd=tmp_path,
    )
    assert made.code == 0, made.err
    asked = (
        "bench",
        "traffic",
        "--data",
        "w",
        "--scenes",
        "8",
        "--samples",
        "2",
        "--policies",
        "diffusion,trafficsim",
    )
    done = advdiff(*asked, "--workers", "1", "--out", "t", cwd=tmp_path)
    assert done.code == 0, done.err
    rows = {
        (row["row"], row["column"]): row
        for row in csv.DictReader((tmp_path / "t" / "table.csv").read_text().splitlines())
    }
    assert rows["latent diffusion (ours)", "min_sfde_m"]["n"] == "8"
    assert ("the log itself", "env_rate") in rows
    assert float(rows["latent diffusion (ours)", "fdd_m"]["value"]) > 0.0
    assert rows["TrafficSim (prior)", "jsd_ttc"]["paper"] == "1.85"
    before = (tmp_path / "t" / "table.csv").read_bytes()
    for file in ("done.json", "table.csv"):
        (tmp_path / "t" / file).unlink()
    again = advdiff(*asked, "--workers", "1", "--out", "t", cwd=tmp_path)
    assert again.code == 0, again.err
    assert (tmp_path / "t" / "table.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("adversarial", "--scenes", "0"), "--scenes 0: give a number above 0, or the file of a list"),
        (("adversarial", "--scenes", "none.json"), "none.json: cannot be read"),
        (("adversarial", "--scenes", "."), "holds no driving log of a known kind"),
        (("adversarial", "--licence", "legal"), "bench adversarial: licence = 'legal'"),
        (
            ("adversarial", "--policies", "diffusoin"),
            "unknown background 'diffusoin'; did you mean 'diffusion'?",
        ),
        (("adversarial", "--targets", "IDN"), "unknown target 'IDN'; did you mean 'IDM'?"),
        (("adversarial", "--policies", "replay,,sumo"), "a name is empty; write them as a,b"),
        (("adversarial", "--horizon", "0"), "bench adversarial: horizon_s = 0.0"),
        (("transfer", "--policies", "replay"), "only these can be adapted"),
        (("traffic", "--policies", "strife"), "bench traffic has no such row"),
        (("traffic", "--scenes", "few"), "--scenes few: give the number of windows"),
    ],
)
def test_bad_input_gets_a_sentence(
    given: tuple[str, ...], said: str, here: Callable[..., Outcome], workplace: Path
) -> None:
    done = here("bench", *given, "--out", "out")
    assert done.code == 2
    assert len(done.err.splitlines()) == 1
    assert said in done.err


def _wait_for(folder: Path, count: int) -> None:
    deadline = time.monotonic() + HANG_S
    while sum(path.is_file() for path in folder.rglob("*")) < count:
        assert time.monotonic() < deadline, "no episode came"
        time.sleep(0.05)
