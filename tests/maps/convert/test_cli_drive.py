"""``convert --drive`` and ``--drive-at-once`` treat a number of vehicles differently and store separate results."""

from __future__ import annotations

import json
from pathlib import Path

import typer
from small_maps import MapBuilder
from typer.testing import CliRunner

from advdiff_sumo.cli.convert import convert
from advdiff_sumo.core.errors import NetError


def street(path: Path) -> Path:
    road = MapBuilder()
    end = road.straight("a", (0.0, 100.0, 0.0), 150.0)
    end = road.straight("a-b", end, 10.0, connector=True)
    road.straight("b", end, 150.0)
    road.link("a", "a-b", "b")
    return road.write(path)


def test_both_readings(tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(convert)
    net = tmp_path / "street.net.xml"
    words = [str(street(tmp_path / "street.json")), "-o", str(net), "--report"]
    done = CliRunner().invoke(app, [*words, "--drive", "7", "--drive-at-once", "3"])
    assert done.exit_code == 0, done.output
    figures = json.loads((tmp_path / "street.fidelity.json").read_text())
    in_the_hour, at_once = figures["driving_test_in_the_hour"], figures["driving_test_at_once"]
    assert (in_the_hour["vehicles"], in_the_hour["vehicles_most"]) == (7, 1)
    assert in_the_hour["arrived"] == 7
    assert (at_once["vehicles"], at_once["vehicles_most"]) == (3, 3)
    assert at_once["arrived"] > 100
    page = (tmp_path / "street.fidelity.html").read_text()
    assert "7 vehicles set out within the hour: teleports" in page
    assert "3 vehicles on the road at any time: teleports" in page
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "driving_test" not in (tmp_path / "street.fidelity.json").read_text()
    assert "street.fidelity.html" in done.output.replace("\n", "")
    assert CliRunner().invoke(app, words[:-1]).exit_code == 0
    assert not (tmp_path / "street.fidelity.html").exists(), "it was of another conversion"


def test_figures_are_kept_where_there_is_no_trip(tmp_path: Path) -> None:
    road = MapBuilder()
    road.straight("a", (0.0, 100.0, 0.0), 30.0)
    app = typer.Typer()
    app.command()(convert)
    words = [str(road.write(tmp_path / "short.json")), "-o", str(tmp_path / "short.net.xml"), "--drive", "3"]
    done = CliRunner().invoke(app, words)
    assert isinstance(done.exception, NetError)
    assert "holds no way of 50 m" in str(done.exception)
    assert json.loads((tmp_path / "short.fidelity.json").read_text())["lanes"]["held"] == 1
