"""Nets that SUMO takes without a word, and on which episodes say little."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import sumo

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.net_oddities import net_oddities
from advdiff_sumo.maps.shipped_nets import shipped_networks
from advdiff_sumo.sim.run_episodes import Run, RunOptions


def sentences(net: Path) -> list[str]:
    """Return what is odd in *net*, without its name."""
    return [sentence.removeprefix(f"{net}: ") for sentence in net_oddities(RoadMap.read(net))]


@pytest.mark.parametrize("net", sorted(shipped_networks().glob("*.net.xml")), ids=lambda path: path.name)
def test_shipped_nets_have_nothing_odd(net: Path) -> None:
    assert sentences(net) == []


def test_small_sound_nets_have_nothing_odd(cross: Path, cross_left: Path) -> None:
    assert sentences(cross) == sentences(cross_left) == []


def test_vehicles_leap_over_junctions_without_lanes(make_cross: Callable[..., Path]) -> None:
    assert sentences(make_cross("--no-internal-links")) == [
        "vehicles leap over 1 junction without lanes; write it anew with netconvert, without --no-internal-links"
    ]


def test_nobody_yields_at_an_unregulated_junction(make_cross: Callable[..., Path]) -> None:
    assert sentences(make_cross(kind="unregulated")) == [
        "nobody yields at 1 junction of type 'unregulated'; write it anew with netconvert, with another type, such as "
        "priority"
    ]


def test_lanes_of_both_directions_on_each_other(tmp_path: Path) -> None:
    net = tmp_path / "grid.net.xml"
    words = ["--grid", "--grid.number=2", "--grid.length=100", "--default.spreadtype=center", f"-o={net}"]
    subprocess.run([str(Path(sumo.SUMO_HOME, "bin/netgenerate")), *words], check=True, capture_output=True)
    said = sentences(net)
    assert said == [
        "traffic meets head-on on 8 lanes, such as 'A0A1_0', less than 1.8 m beside one of the other direction; write "
        "it anew with netconvert, with spreadType right for streets of two directions"
    ]


@pytest.mark.parametrize(("left", "side", "option"), [(True, "left", "with"), (False, "right", "without")])
def test_a_net_that_states_the_other_side(
    cross: Path, cross_left: Path, tmp_path: Path, left: bool, side: str, option: str
) -> None:
    content = (cross_left if left else cross).read_text()
    net = tmp_path / "other.net.xml"
    wrong = (
        content.replace(' lefthand="true"', "") if left else content.replace("<net ", '<net lefthand="true" ')
    )
    net.write_text(wrong)
    assert sentences(net) == [
        f"traffic keeps {side} by its lanes, but not by its 'lefthand'; make it anew {option} --lefthand"
    ]


def test_a_run_says_so(make_cross: Callable[..., Path]) -> None:
    net = make_cross(kind="unregulated")
    (note,) = Run.prepare(RunOptions(net=str(net))).notes()
    assert note.startswith(f"{net}: nobody yields at 1 junction")
