"""Names and options of targets."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sumo  # type: ignore[import-untyped]

from advdiff_sumo.core.errors import ConfigError, UnknownNameError
from advdiff_sumo.planners.planner_protocol import Planner, SumoDriver
from advdiff_sumo.planners.planner_registry import TARGETS, make_target
from advdiff_sumo.planners.sumo_models import CAR_FOLLOWING, PARAMS, SumoDriverOptions


class Idle:
    """A user's planner, which does nothing."""

    def __init__(self, patience_s: float = 1.0) -> None:
        self.patience_s = patience_s

    def start(self, road: Any, scene: Any, rng: np.random.Generator) -> Any:
        return road, scene, rng

    def plan(self, road: Any, scene: Any, memory: Any, rng: np.random.Generator) -> Any:
        return scene, memory


class NoPlanner:
    """Lacks plan()."""

    def start(self) -> None: ...


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> str:
    """Return this module under a name that can be imported."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    return "test_planner_registry"


@pytest.mark.parametrize("name", CAR_FOLLOWING)
def test_every_car_following_model_is_a_target(name: str) -> None:
    assert make_target(name, {}) == SumoDriver(name, "SL2015", {})


@pytest.mark.parametrize("name", ["idm", "IDM", " Idm ", "iDm"])
def test_case_does_not_matter(name: str) -> None:
    assert make_target(name, {}).car_following == "IDM"  # type: ignore[union-attr] # a SUMO driver


@pytest.mark.parametrize("name", ["lane_graph", "Lane-Graph", "LANE_GRAPH"])
def test_lane_graph_is_a_planner(name: str) -> None:
    assert isinstance(make_target(name, {}), Planner)


def test_options_reach_the_vehicle_type() -> None:
    options = {"lane_change": "lc2013", "tau": 0.8, "minGap": 1, "params": {"lcSpeedGain": 3.0}}
    driver = make_target("krauss", options)
    assert driver == SumoDriver("Krauss", "LC2013", {"tau": 0.8, "minGap": 1.0, "lcSpeedGain": 3.0})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tua": 1.0}, "did you mean 'tau'"),
        ({"tau": -1.0}, "tau = -1.0"),
        ({"lane_change": "LC9"}, "LC2013"),
        ({"params": {"lcSpeedGian": 1.0}}, "did you mean 'lcSpeedGain'"),
        ({"params": {"tau": 1.0}}, "option of its own"),
        ({"params": {"zzz": 1.0}}, "no driving attribute 'zzz'"),
        ({"decel": 5.0, "emergencyDecel": 4.0}, "at least decel"),
    ],
)
def test_a_bad_option_says_what_to_do(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match="target 'IDM'") as caught:
        make_target("IDM", options)
    assert words in str(caught.value)


def test_an_unknown_target_gets_a_suggestion() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'lane_graph'"):
        make_target("lane_grpah", {})


def test_a_users_own_class(here: str) -> None:
    planner = make_target(f"{here}:Idle", {"patience_s": 3.0})
    assert planner.patience_s == 3.0  # type: ignore[union-attr] # it is Idle


@pytest.mark.parametrize(
    ("attribute", "options", "words"),
    [
        ("Idle", {"patince_s": 3.0}, "did you mean 'patience_s'"),
        ("NoPlanner", {}, "lacks plan"),
        ("Missing", {}, "cannot be imported"),
        ("Idle.__doc__", {}, "is a str"),
    ],
)
def test_a_wrong_class_of_a_user(here: str, attribute: str, options: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        make_target(f"{here}:{attribute}", options)


def test_names_list_every_target() -> None:
    assert {*CAR_FOLLOWING, "lane_graph"} <= set(TARGETS.names())


def test_params_are_attributes_of_sumos_schema() -> None:
    schema = ElementTree.parse(Path(sumo.SUMO_HOME, "data/xsd/types/route.xsd"))  # noqa: S314 - SUMO's own
    space = "{http://www.w3.org/2001/XMLSchema}"
    base = next(t for t in schema.iter(f"{space}complexType") if t.get("name") == "vTypeBaseType")
    attributes = {a.get("name") for a in base.iter(f"{space}attribute")}
    models = {e.get("name") for e in base.iter(f"{space}element")}
    known = set(SumoDriverOptions.model_fields) - {"lane_change", "params"}
    assert attributes >= PARAMS
    assert attributes >= known
    assert not PARAMS & known
    assert {f"carFollowing-{name}" for name in CAR_FOLLOWING} - models <= {"carFollowing-KraussX"}
