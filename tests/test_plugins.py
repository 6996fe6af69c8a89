"""Names of plug-ins are resolved independently of case; unknown names get a suggestion."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import ConfigError, UnknownNameError
from advdiff_sumo.planners.planner_registry import TARGETS
from advdiff_sumo.plugins import Registry, fold
from advdiff_sumo.traffic.policy_registry import POLICIES

SHAPES = Registry("shape", "advdiff_sumo.tests_none", {"lane_graph": "fractions:Fraction", "IDM": "math:tau"})


@pytest.mark.parametrize("name", ["lane_graph", "Lane-Graph", "LANE_GRAPH", "  lane-graph "])
def test_case_hyphen_and_space_do_not_matter(name: str) -> None:
    assert fold(name) == "lane_graph"
    assert SHAPES.canonical(name) == "lane_graph"
    assert SHAPES.load(name) is Fraction


def test_the_spelling_of_the_registry_is_kept() -> None:
    assert SHAPES.canonical("idm") == "IDM"
    assert SHAPES.load("idm") == math.tau
    assert SHAPES.names() == ["lane_graph", "IDM"]


def test_a_users_own_class() -> None:
    assert SHAPES.load("fractions:Fraction") is Fraction
    assert SHAPES.load("pathlib:Path.cwd")() == Path.cwd()
    assert SHAPES.canonical("Some.Module:Class") == "Some.Module:Class", "Python's names keep their case"


def test_an_unknown_name_gets_a_suggestion() -> None:
    with pytest.raises(UnknownNameError) as caught:
        SHAPES.load("lane_grap")
    assert str(caught.value) == "unknown shape 'lane_grap'; did you mean 'lane_graph'?"
    assert (caught.value.kind, caught.value.name) == ("shape", "lane_grap")
    with pytest.raises(UnknownNameError, match="unknown shape 'zebra'; known are: IDM, lane_graph"):
        SHAPES.canonical("zebra")


@pytest.mark.parametrize(
    "name",
    ["no_such_module_here:X", "fractions:NoSuchClass", "fractions:", ":Fraction", "fractions:Fraction.no"],
)
def test_a_failed_import_gets_one_sentence(name: str) -> None:
    with pytest.raises(ConfigError, match=f"shape '{name}' cannot be imported: ") as caught:
        SHAPES.load(name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("fractions:Fractoin", "; did you mean 'Fraction'?"),
        ("fractions:", ": give it as module:CLASS"),
        (":Fraction", ": give it as module:CLASS"),
        ("own_shape.py:Square", "; leave .py out: own_shape:Square"),
        ("own_shape", "a class of own_shape.py is given as own_shape:CLASS"),
        ("own_shape.py", "a class of own_shape.py is given as own_shape:CLASS"),
        ("own_shape.Square", "a class of own_shape.py is given as own_shape:Square"),
        ("shapes/round.py", "a class of shapes/round.py is given as shapes.round:CLASS"),
        ("shapes.round", "a class of shapes/round.py is given as shapes.round:CLASS"),
        ("shapes.round.Circle", "a class of shapes/round.py is given as shapes.round:Circle"),
        ("shapes/round.py:Circle", "a module is named, not its path: shapes.round:Circle"),
        ("shapes/round:Circle", "a module is named, not its path: shapes.round:Circle"),
        ("../{here}/own_shape.py:Square", "its path: own_shape:Square, with ../{here} on PYTHONPATH"),
        ("../nowhere:Square", "a module is named, not its path: package.module:Square"),
        ("own_shape:Square", "No module named 'no_such_thing' (own_shape.py, line 1, <module>); correct it"),
    ],
)
def test_a_users_class_that_is_given_wrongly_gets_a_remedy(
    name: str, remedy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_shape.py").write_text("import no_such_thing\n")
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "round.py").write_text("class Circle: pass\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ConfigError) as caught:
        SHAPES.load(name.format(here=tmp_path.name))
    assert remedy.format(here=tmp_path.name) in str(caught.value)


def test_an_address_is_refused_as_a_class() -> None:
    with pytest.raises(ConfigError, match="cannot be reached: write it as grpc://HOST:PORT"):
        SHAPES.load("http://localhost:5999")


def test_a_module_that_is_not_found_gets_a_hint_on_the_folder() -> None:
    with pytest.raises(ConfigError, match=r"start in the folder of no_such\.py or put that on PYTHONPATH"):
        SHAPES.load("no_such.part:X")
    with pytest.raises(
        ConfigError, match="defined in a script or a notebook: put it into a module of its own"
    ):
        SHAPES.load("__main__:NoSuchClass")


def install(entry_point: str, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Install a package in *folder* that registers *entry_point* in the group of the shapes."""
    info = folder / "their_plugin-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: their-plugin\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{SHAPES.group}]\n{entry_point}\n")
    monkeypatch.syspath_prepend(str(folder))


def test_a_users_file_that_a_module_of_its_name_hides_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hidden = tmp_path / "fractions.py"
    hidden.write_text("class MyPlanner: ...\n")
    monkeypatch.chdir(tmp_path)
    problem = "target 'fractions:MyPlanner' cannot be imported: 'fractions' has no attribute 'MyPlanner'"
    with pytest.raises(ConfigError) as refused:
        TARGETS.load("fractions:MyPlanner")
    assert str(refused.value) == f"{problem}; this module hides {hidden}: give that file another name"
    hidden.unlink()
    with pytest.raises(ConfigError) as unhidden:
        TARGETS.load("fractions:MyPlanner")
    assert "hides" not in str(unhidden.value)


def test_plugins_come_from_entry_points(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    install("Their_Planner = fractions:Fraction", monkeypatch, tmp_path)
    assert SHAPES.names() == ["lane_graph", "IDM", "Their_Planner"]
    assert SHAPES.load("their-planner") is Fraction
    assert SHAPES.described()["Their_Planner"] == "plug-in fractions:Fraction"


def test_a_plugin_does_not_replace_a_built_in(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    install("lane_graph = decimal:Decimal", monkeypatch, tmp_path)
    assert SHAPES.load("lane_graph") is Fraction
    assert SHAPES.described() == {"lane_graph": "fractions:Fraction", "IDM": "math:tau"}


@pytest.mark.parametrize("registry", [TARGETS, POLICIES])
def test_every_built_in_has_a_description(registry: Registry) -> None:
    described = registry.described()
    assert list(described)[: len(registry.builtins)] == list(registry.builtins)
    assert not [name for name, source in registry.builtins.items() if described[name] == source]
    assert registry.descriptions.keys() == registry.builtins.keys()
