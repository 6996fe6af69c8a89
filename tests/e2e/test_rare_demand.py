"""Runs with unusual demand files: gzipped, given by a configuration, with ids that XML must escape."""

from __future__ import annotations

import gzip
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import advdiff

LENGTH_M = 7.25  # no vehicle type of SUMO or ours has this length
RENAMED = ("A0A1", "A0&lt;A1")
TINY = ("--horizon", 2, "--episodes", 1, "--set", "scene.warmup_s=12", "--set", "scene.min_neighbours=0")
TYPES = f'<additional><vType id="mine" length="{LENGTH_M}"/></additional>'
LOOPS = '<additional><e1Detector id="e" lane="A1A2_0" pos="1" period="1" file="loops.out.xml"/></additional>'
STOPS = '<additional><busStop id="stop" lane="A1A2_0" startPos="30" endPos="60"/></additional>'
ROUTES = """<routes>
<flow id="on" type="mine" begin="0" end="60" period="3" from="A0&lt;A1" to="C1C2" departLane="best"/>
<flow id="stops" type="mine" begin="0" end="60" period="5" from="A0&lt;A1" to="C1C2">
<stop busStop="stop" duration="2"/></flow>
</routes>"""
CONFIGURATION = """<configuration><input><net-file value="grid.net.xml.gz"/><route-files value="d.rou.xml.gz"/>
<additional-files value="types.add.xml, stops.add.xml, loops.add.xml"/></input></configuration>"""


@pytest.fixture
def place(grid: Path, tmp_path: Path) -> Path:
    """Return a folder with a net with a street whose id contains "<", and demand of 7.25 m long vehicles on it."""
    net = grid.read_text()
    assert RENAMED[0] in net
    net = net.replace(*RENAMED)
    (tmp_path / "grid.net.xml.gz").write_bytes(gzip.compress(net.encode(), mtime=0))
    (tmp_path / "d.rou.xml.gz").write_bytes(gzip.compress(ROUTES.encode(), mtime=0))
    for name, content in {"types": TYPES, "loops": LOOPS, "stops": STOPS}.items():
        (tmp_path / f"{name}.add.xml").write_text(content)
    (tmp_path / "grid.sumocfg").write_text(CONFIGURATION)
    return tmp_path


def lengths_m(folder: Path) -> set[float]:
    """Return the lengths of all vehicles of a run."""
    return set(pq.read_table(folder / "states.parquet")["length_m"].to_pylist())


def test_a_configuration_provides_routes_types_and_stops_and_omissions_are_reported(
    place: Path,
) -> None:
    done = advdiff("run", "--net", "grid.sumocfg", *TINY, "--out", "run", cwd=place)
    assert done.code == 0, done.out + done.err
    (row,) = pq.read_table(place / "run" / "episodes.parquet").to_pylist()
    assert row["failure_kind"] is None
    assert lengths_m(place / "run") == {LENGTH_M}
    said = " ".join(done.out.split())
    assert "loops.add.xml holds detectors and outputs only, and is left out" in said
    assert "types.add.xml" not in said
    assert "stops.add.xml" not in said
    assert not list(place.rglob("loops.out.xml"))


@pytest.mark.slow
def test_gzipped_routes_alone_are_demand(place: Path) -> None:
    routes = ROUTES.replace("<routes>", f'<routes><vType id="mine" length="{LENGTH_M}"/><!-- no stop -->')
    routes = routes[: routes.index('<flow id="stops"')] + "</routes>"
    (place / "own.rou.xml.gz").write_bytes(gzip.compress(routes.encode(), mtime=0))
    words = ("run", "--net", "grid.net.xml.gz", "--demand", "own.rou.xml.gz", *TINY)
    done = advdiff(*words, "--out", "run", cwd=place)
    assert done.code == 0, done.out + done.err
    (row,) = pq.read_table(place / "run" / "episodes.parquet").to_pylist()
    assert row["failure_kind"] is None
    assert lengths_m(place / "run") == {LENGTH_M}
    assert "left out" not in done.out


@pytest.mark.slow
def test_a_sweep_reports_omissions_once(place: Path) -> None:
    net = '{ net = "grid.net.xml.gz", demand = "grid.sumocfg" }'
    grid = f'[grid]\nnets = [{net}]\ntargets = ["IDM", "Krauss"]\nbackgrounds = ["sumo"]\n'
    scene = "[scene]\nwarmup_s = 12.0\nmin_neighbours = 0\n"
    (place / "two.toml").write_text(f"episodes = 1\nhorizon_s = 1.0\n{scene}{grid}")
    done = advdiff("sweep", "two.toml", "--workers", 1, "--no-report", "--out", "s", cwd=place)
    assert done.code == 0, done.out + done.err
    assert done.out.count("loops.add.xml holds detectors and outputs only, and is left out") == 1
