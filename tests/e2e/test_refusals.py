"""Bad input: exit code 2, one sentence that names the cause and the remedy, and no file is lost or created."""

from __future__ import annotations

import gzip
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import sumolib

from tests.e2e.commands import TINY, Outcome, advdiff, everything
from tests.e2e.conftest import sentence

Refused = Callable[..., str]
GRID = ("run", "--net", "grid.net.xml", "--episodes", "1", "--horizon", "2", "--out", "out")
STREET = '<nodes><node id="A" x="0" y="0"/><node id="B" x="100" y="0"/><node id="C" x="200" y="0"/></nodes>'


def _missing(said: str, *words: str) -> list[str]:
    """Return the *words* that are missing in the sentence *said*, followed by the sentence."""
    return [f"{word!r} in {said!r}" for word in words if word not in said]


def _netconvert(folder: Path, edges: str) -> None:
    (folder / "a.nod.xml").write_text(STREET)
    (folder / "a.edg.xml").write_text(f"<edges>{edges}</edges>")
    files = ("-n", "a.nod.xml", "-e", "a.edg.xml", "-o", "other.net.xml")
    command = [sumolib.checkBinary("netconvert"), *files, "--no-turnarounds", "true"]
    subprocess.run(command, check=True, capture_output=True, cwd=folder)


def test_a_temporary_folder_whose_path_is_too_long_for_sockets(
    workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = workplace / ("x" * 90)
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    said = sentence(advdiff(*GRID, cwd=workplace, program=(sys.executable, "-B", "-m", "advdiff_sumo")))
    assert not _missing(said, str(temporary), "TMPDIR", "shorter path")


# --- nets ------------------------------------------------------------------------------------------------


def test_a_missing_net_in_a_process_of_its_own(workplace: Path) -> None:
    before = everything(workplace)
    said = sentence(advdiff("run", "--net", "none.net.xml", "--out", "out", cwd=workplace))
    assert not _missing(said, "none.net.xml: no such net", "downtown-left")
    assert everything(workplace) == before


def test_a_net_that_ends_in_the_middle(workplace: Path, refused: Refused) -> None:
    net = workplace / "grid.net.xml"
    text = net.read_text()
    net.write_text(text[: len(text) // 2])
    assert not _missing(refused(*GRID), "grid.net.xml: ", "line ", "truncated", "anew")
    net.write_bytes(gzip.compress(text.encode())[:2000])
    assert not _missing(refused(*GRID), "grid.net.xml: ", "gzip data are cut off")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"<routes><vType id='a'/></routes>", ("not a SUMO net", "<routes>", "<net>")),
        (bytes(range(256)) * 8, ("not readable as XML", "anew")),
        (b"", ("not readable as XML", "line 1", "anew")),
    ],
    ids=["another kind of XML", "binary", "empty"],
)
def test_a_file_that_is_no_net(
    workplace: Path, refused: Refused, content: bytes, words: tuple[str, ...]
) -> None:
    (workplace / "other.net.xml").write_bytes(content)
    assert not _missing(refused("run", "--net", "other.net.xml", "--out", "out"), "other.net.xml: ", *words)


def test_a_folder_is_no_net(workplace: Path, refused: Refused) -> None:
    (workplace / "other.net.xml").mkdir()
    assert not _missing(
        refused("run", "--net", "other.net.xml"), "other.net.xml: is no file", "give a .net.xml"
    )


@pytest.mark.parametrize(
    ("edges", "words"),
    [
        ('<edge id="AB" from="A" to="B" allow="pedestrian"/>', ("no lane that is open to motor vehicles",)),
        ('<edge id="AB" from="A" to="B"/>', ("no route that a car could drive", "connected edges")),
    ],
    ids=["a footpath", "one dead edge"],
)
def test_a_net_without_a_drivable_route(
    workplace: Path, refused: Refused, edges: str, words: tuple[str, ...]
) -> None:
    _netconvert(workplace, edges)
    assert not _missing(refused("run", "--net", "other.net.xml", "--out", "out"), "other.net.xml: ", *words)


# --- names and options -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--target", "IDMN"), ("unknown target 'IDMN'", "did you mean 'IDM'?")),
        (("--target", "zzz"), ("unknown target 'zzz'", "known are: ", "Krauss", "lane_graph")),
        (("--background", "replai"), ("unknown background 'replai'", "did you mean 'replay'?")),
        (("--set", "scene.warmup=3"), ("no option 'scene.warmup'", "did you mean 'warmup_s'?")),
        (("--set", "sceen.warmup_s=3"), ("no option 'sceen'", "did you mean 'scene'?")),
        (("--set", "sim.step_s=7"), ("sim.step_s = 7", "less than or equal to 0.5")),
        (("--set", "sim.step_s=fast"), ("sim.step_s = 'fast'", "valid number")),
        (("--set", "sim.step_s=0.3"), ("model_step_s = 0.5 is no whole multiple of 0.3",)),
        (
            ("--target", "lane_graph", "--set", "sim.replan_every=5"),
            ("target 'lane_graph' plans 2 s", "set sim.replan_every to 4 at most"),
        ),
        (("--set", "warmup"), ("--set warmup", "NAME=VALUE", "for example")),
        (("--set", "seed.a=1"), ("seed", "valid integer")),
        (("--set", "target_options.tauu=1"), ("options of target 'IDM'", "did you mean 'tau'?")),
        (("--set", "target_options.tau=-1"), ("tau = -1", "greater than 0")),
        (("--set", "target_options.lane_change=LC13"), ("lane_change = 'LC13'", "'LC2013', 'SL2015'")),
        (("--set", "target_options.tau=nan"), ("target_options: tau = nan: give finite numbers",)),
        (("--set", "background_options.a=1"), ("options of background 'sumo'", "no option 'a'")),
        (("--strength", "0.5"), ("options of background 'sumo'", "no option 'strength'")),
        (("--background", "diffusion", "--strength", "2"), ("strength = 2.0", "less than or equal to 1")),
        (("--background", "diffusion", "--attack", "ram"), ("attack = 'ram'", "'cut-in'", "'head-on'")),
        (
            ("--background", "diffusion", "--weights", "none.safetensors"),
            ("none.safetensors: no such file", "shipped weights"),
        ),
        (("--horizon", "-3"), ("horizon_s = -3", "greater than 0")),
        (("--horizon", "nan"), ("horizon_s = nan", "finite")),
        (("--episodes", "0"), ("episodes = 0", "greater than or equal to 1")),
        (("--seed", "-1"), ("seed = -1", "greater than or equal to 0")),
        (("--seed", "99999999999999999999"), ("seed = 99999999999999999999", f"less than {2**63}")),
        (("--target", "grpc:localhost:1"), ("is written grpc://HOST:PORT", "'grpc://localhost:1'?")),
        (("--episodes", "abc"), ("'--episodes'", "valid integer", "advdiff-sumo run --help")),
        (("--horizont", "3"), ("--horizont", "--horizon")),
        (("--horizon",), ("'--horizon' requires an argument", "advdiff-sumo run --help")),
        (("more",), ("unexpected", "more", "advdiff-sumo run --help")),
        (("--scenes", ".", "--demand", "a.rou.xml"), ("demand and scenes cannot go together",)),
        (("--resume",), ("out: holds no run to go on with", "leave --resume out")),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, tuple) and words[0].startswith("-") else "",
)
def test_an_unusable_option(refused: Refused, words: tuple[str, ...], expected: tuple[str, ...]) -> None:
    assert not _missing(refused(*GRID, *words), *expected)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere windows need no DISPLAY")
def test_a_window_without_a_display(refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    assert not _missing(refused(*GRID, "--gui"), "--gui needs a display", "leave --gui out")


def test_an_unknown_verb(refused: Refused) -> None:
    assert not _missing(refused("rum"), "'rum'", "'run'", "advdiff-sumo --help")


def test_a_lane_change_model_that_does_not_fit_sublanes(refused: Refused) -> None:
    quick = (
        "--set",
        "scene.warmup_s=5",
        "--set",
        "scene.min_neighbours=0",
        "--set",
        "scene.scenes_per_warmup=1",
    )
    said = refused(*GRID, *quick, "--set", "target_options.lane_change=LC2013")
    assert not _missing(said, "LC2013", "sim.lateral_resolution_m = 0", "SL2015")


def test_traffic_without_a_target(refused: Refused) -> None:
    words = ("--set", "scene.warmup_s=5", "--set", "scene.min_neighbours=900", "--set", "scene.spacing_s=1")
    assert not _missing(
        refused(*GRID, *words), "grid.net.xml: no vehicle with 900 others", "lower scene.min_neighbours"
    )


# --- configuration files ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'net = "downtown"\nepisodes = = 3\n', ("not valid TOML", "line 2, column 12", "correct that line")),
        (b"episods = 3\n", ("no option 'episods'", "did you mean 'episodes'?")),
        (b"[options]\nsead = 3\n", ("no option 'sead'", "did you mean 'seed'?")),
        (b"options = 3\n", ("[options] is not a table",)),
        (b"\xff\xfe\x00", ("not valid TOML",)),
    ],
)
def test_a_malformed_configuration(
    workplace: Path, refused: Refused, content: bytes, words: tuple[str, ...]
) -> None:
    (workplace / "own.toml").write_bytes(content)
    assert not _missing(refused("run", "--config", "own.toml", "--out", "out"), "own.toml: ", *words)


def test_no_configuration(workplace: Path, refused: Refused) -> None:
    assert not _missing(refused("run", "--config", "none.toml"), "none.toml: no such file")
    assert not _missing(refused("run", "--config", "."), "cannot be read", "directory")


# --- where results go ------------------------------------------------------------------------------------


def test_a_folder_that_cannot_be_written(workplace: Path, refused: Refused) -> None:
    (workplace / "file").write_text("mine")
    assert not _missing(refused(*GRID[:-1], "file/below"), "file/below: cannot be written", "another --out")
    assert not _missing(refused(*GRID[:-1], "file"), "file: cannot be written", "another --out")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no /proc on this system")
def test_a_folder_where_nobody_may_write(refused: Refused) -> None:
    assert not _missing(
        refused(*GRID[:-1], "/proc/advdiff/new"), "/proc/advdiff/new: cannot be written", "another --out"
    )


def test_a_folder_that_holds_something_else(workplace: Path, refused: Refused) -> None:
    (workplace / "out").mkdir()
    (workplace / "out" / "thesis.tex").write_text("mine")
    assert not _missing(refused(*GRID), "out: ", "holds other files", "new --out")
    assert not _missing(refused(*GRID, "--resume"), "out: holds no run to go on with")


def test_a_folder_that_holds_another_run(
    here: Callable[..., Outcome], refused: Refused, workplace: Path
) -> None:
    words = ("run", "--net", "grid.net.xml", *TINY, "--out", "out")
    assert here(*words, "--episodes", 2).code == 0
    assert not _missing(refused(*words, "--episodes", 2), "already holds a run", "new --out", "--resume")
    assert not _missing(
        refused(*words, "--resume", "--seed", 7), "that run had seed = 0, not 7", "leave that option out"
    )
    assert not _missing(refused(*words, "--resume", "--episodes", 1), "has 2 episodes", "ask for as many")
    assert refused("replay", 0, "--run", "out", "--out", "out").endswith("holds a run; choose a new --out")
    states = workplace / "out" / "states.parquet"
    states.write_bytes(states.read_bytes()[:2000])
    for again in (("replay", 0, "--run", "out"), ("run", "--resume", "--out", "out")):
        assert not _missing(refused(*again), "states.parquet: is damaged", "run --config out/run.toml")


def test_resume_needs_a_folder(refused: Refused) -> None:
    assert not _missing(refused("run", "--resume"), "--resume", "add its folder with --out")


# --- demand and logs -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            '<routes><vehicle id="a" depart="0"><route edges="x y"/></vehicle></routes>',
            ("another net", "'x'"),
        ),
        (
            '<routes><vehicle id="a" depart="0"><route edges="x',
            ("not well-formed", "line 1", "export it again"),
        ),
        ("<routes/>", ("no vehicle, trip or flow", "give demand")),
        ("time,vehicle\n0,1\n", ("not well-formed",)),
    ],
    ids=["of another net", "truncated", "empty", "no XML"],
)
def test_demand_that_cannot_be_used(
    workplace: Path, refused: Refused, content: str, words: tuple[str, ...]
) -> None:
    (workplace / "own.rou.xml").write_text(content)
    assert not _missing(refused(*GRID, "--demand", "own.rou.xml"), "own.rou.xml: ", *words)


def test_demand_that_is_not_there(workplace: Path, refused: Refused) -> None:
    assert not _missing(
        refused(*GRID, "--demand", "none.rou.xml"), "none.rou.xml: no such demand file", ".sumocfg"
    )
    assert not _missing(refused(*GRID, "--demand", "."), "is no file", ".rou.xml")
    (workplace / "own.sumocfg").write_text('<c><input><route-files value="gone.rou.xml"/></input></c>')
    assert not _missing(
        refused(*GRID, "--demand", "own.sumocfg"), "gone.rou.xml: no such", "own.sumocfg names it"
    )
    (workplace / "own.sumocfg").write_text('<c><input><net-file value="grid.net.xml"/></input></c>')
    assert not _missing(refused(*GRID, "--demand", "own.sumocfg"), "own.sumocfg: names no route-files")


def test_scenes_that_are_no_log(workplace: Path, refused: Refused) -> None:
    assert not _missing(refused(*GRID, "--scenes", "none"), "none: no such log", "nuScenes")
    (workplace / "notes").mkdir()
    (workplace / "notes" / "today.txt").write_text("rain")
    assert not _missing(refused(*GRID, "--scenes", "notes"), "notes: holds no driving log", "v1.0-*")
    (workplace / "notes" / "today.pkl").write_bytes(b"no pickle at all")
    assert not _missing(refused(*GRID, "--scenes", "notes/today.pkl"), "today.pkl")


@pytest.mark.data
def test_a_log_of_another_net(adv_data: Path, refused: Refused) -> None:
    said = refused(*GRID, "--scenes", adv_data / "nuscenes-mini")
    assert not _missing(said, "grid.net.xml: ", "none of the log's drives is on this net", "convert")


# --- a user's own classes --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("option", "name", "words"),
    [
        ("--target", "our_planners:Missing", ("cannot be imported", "'Missing'")),
        ("--target", "no_such_module:Class", ("cannot be imported", "no_such_module")),
        ("--target", "our_planners:Nothing", ("is no planner", "lacks start and plan")),
        ("--target", "our_planners:Broken", ("RuntimeError: no weights found", "correct it")),
        ("--target", "our_planners:time", ("'our_planners:time'",)),
        ("--background", "our_planners:Nothing", ("is no policy", "lacks start and plan")),
        ("--background", "half:Done", ("'half:Done'", "SyntaxError")),
    ],
)
def test_a_class_that_cannot_be_used(
    workplace: Path, refused: Refused, option: str, name: str, words: tuple[str, ...]
) -> None:
    (workplace / "half.py").write_text("class Done(:\n")
    assert not _missing(refused(*GRID, option, name), *words)


# --- convert ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), ("MAP", "--all")),
        (("none.json",), ("-o NAME.net.xml",)),
        (("none.json", "-o", "new.net.xml"), ("none.json",)),
        (("our_planners.py", "-o", "new.net.xml"), ("our_planners.py",)),
        (("--all", "."), ("maps/expansion",)),
        (("none.json", "-o", "new.net.xml", "--tls", "on"), ("--tls on", "guess")),
    ],
)
def test_a_map_that_cannot_be_converted(
    refused: Refused, words: tuple[str, ...], expected: tuple[str, ...]
) -> None:
    assert not _missing(refused("convert", *words), *expected)


def test_a_cause_of_several_lines_is_printed_in_one_line(
    here: Callable[..., Outcome], workplace: Path
) -> None:
    (workplace / "loud.py").write_text("raise RuntimeError('one\\ntwo')\n")
    assert "one two" in sentence(here(*GRID, "--target", "loud:Class"))
