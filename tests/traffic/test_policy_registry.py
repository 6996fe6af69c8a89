"""Policies by name."""

from __future__ import annotations

from typing import Any

import pytest

from advdiff_sumo.core.errors import ConfigError, UnknownNameError
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy
from advdiff_sumo.traffic.policy_registry import POLICIES, make_policy
from advdiff_sumo.traffic.replay import Replay
from advdiff_sumo.traffic.sumo_traffic import SumoTraffic


def test_names_resolve_in_any_spelling() -> None:
    assert isinstance(make_policy("SUMO", {}), SumoTraffic)
    replay = make_policy("Replay", {"period_s": 2.0})
    assert isinstance(replay, Replay)
    assert replay.options.period_s == 2.0
    assert isinstance(make_policy("advdiff_sumo.traffic.replay:Replay", {}), Replay)


@pytest.mark.parametrize("name", sorted(POLICIES.builtins))
def test_every_built_in_is_a_policy(name: str) -> None:
    assert isinstance(make_policy(name, {}), TrafficPolicy)


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("replay", {"steps": 1}, "no option 'steps'; did you mean 'step_s'?"),
        ("replay", {"step_s": -1.0}, "step_s = -1.0"),
        ("sumo", {"tau": 1.0}, "options of background 'sumo': no option 'tau'; it has none"),
        (
            "sumo",
            {"attack": "cut-in"},
            "no option 'attack'; it has none; scripted and diffusion are backgrounds that",
        ),
        ("advdiff_sumo.traffic.replay:Nobody", {}, "cannot be imported"),
        ("advdiff_sumo.core.scene:AgentClass.CAR", {}, "not a class or function"),
        ("advdiff_sumo.core.seeds:SeedTree", {"root": 1}, "lacks start and plan"),
        ("advdiff_sumo.core.seeds:SeedTree", {"rot": 1}, "no option 'rot'; did you mean 'root'?"),
        ("advdiff_sumo.core.seeds:SeedTree", {}, "root"),
    ],
)
def test_errors_explain_why_a_policy_cannot_be_made(name: str, options: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make_policy(name, options)
    assert said in str(caught.value)


def test_an_unknown_name_gets_a_suggestion() -> None:
    with pytest.raises(UnknownNameError, match="unknown background 'reply'; did you mean 'replay'"):
        make_policy("reply", {})
