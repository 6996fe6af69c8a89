"""Reused plans of this process: the same episodes, without making a plan twice."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.sim.plan_memo import KeptPlans, MadePlan, PlanMemo, PlanSource
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy
from advdiff_sumo.traffic.policy_registry import make_policy
from tests.sim.scenes import episode

SOUND: dict[str, Any] = {}
LATE = {"defects": ["late:strong"]}
SEARCHES = {"rounds": 2}


def memo_of() -> PlanMemo:
    """Return a new memo."""
    return PlanMemo(("net", "policy", "options"), KeptPlans())


class Counted:
    """A policy that counts its plans."""

    def __init__(self, policy: TrafficPolicy) -> None:
        self.policy, self.plans = policy, 0

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Any:
        return self.policy.start(road, scene, log, rng)

    def plan(
        self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator
    ) -> tuple[JointPlan, Any]:
        self.plans += 1
        return self.policy.plan(road, scene, memory, rng)


def driven(
    scene: SeedScene, road: RoadMap, policy: TrafficPolicy, options: dict[str, Any], memo: PlanMemo | None
) -> EpisodeRecord:
    """Return an episode with the rule-based planner of *options*."""
    target = make_target("lane_graph", options)
    record, timing = replace(episode(scene, road, target, policy, 4.0), memo=memo).run()
    assert len(timing.background_plans_s) == 8
    assert min(timing.background_plans_s) > 0.0
    assert timing.cpu_s is not None
    return record


def same(first: EpisodeRecord, second: EpisodeRecord) -> bool:
    """Return whether two episodes are identical to the bit."""
    names = ("xy_m", "yaw_rad", "speed_mps", "valid")
    pairs = ((getattr(first.tracks, name), getattr(second.tracks, name)) for name in names)
    return (
        first.tracks.ids == second.tracks.ids
        and all(one.tobytes() == other.tobytes() for one, other in pairs)
        and first.manoeuvres == second.manoeuvres
        and first.safeguarded == second.safeguarded
    )


@pytest.mark.parametrize(
    ("background", "options"),
    [
        ("scripted", {}),
        ("diffusion", {}),
        ("diffusion", {"licence": "reckless"}),
        pytest.param("strive", SEARCHES, marks=pytest.mark.nightly),
        pytest.param("advsim", SEARCHES, marks=pytest.mark.nightly),
        ("adv-rl", {}),
    ],
)
def test_with_the_memo_episodes_are_the_same_and_plans_are_made_once(
    background: str, options: dict[str, Any], scene: SeedScene, road: RoadMap
) -> None:
    policy, memo = Counted(make_policy(background, options)), memo_of()
    alone = [driven(scene, road, policy, planner, None) for planner in (SOUND, LATE)]
    assert not same(*alone)
    before = policy.plans
    assert before == 16
    assert same(driven(scene, road, policy, SOUND, memo), alone[0])
    assert policy.plans == before + 8
    assert same(driven(scene, road, policy, LATE, memo), alone[1])
    afresh = policy.plans - before - 8
    assert 0 < afresh < 8
    for planner, record in zip((SOUND, LATE), alone, strict=True):
        assert same(driven(scene, road, policy, planner, memo), record)
    assert policy.plans == before + 8 + afresh


def test_another_policy_net_or_option_has_plans_of_its_own(scene: SeedScene, road: RoadMap) -> None:
    policy, made = Counted(make_policy("scripted", {})), KeptPlans()
    for about in (("net", "scripted", "[]"), ("net", "scripted", "[1]"), ("other", "scripted", "[]")):
        before = policy.plans
        driven(scene, road, policy, SOUND, PlanMemo(about, made))
        assert policy.plans == before + 8


def test_a_plan_of_the_memo_counts_with_what_it_took_then(scene: SeedScene, road: RoadMap) -> None:
    policy, memo = make_policy("scripted", {}), memo_of()
    runs = [replace(episode(scene, road, "lane_graph", policy, 2.0), memo=memo).run()[1] for _ in range(2)]
    assert runs[1].background_plans_s == runs[0].background_plans_s
    assert runs[1].wall_s > sum(runs[0].background_plans_s)


def test_a_full_memo_forgets_what_was_used_longest_ago() -> None:
    memo, made = KeptPlans(most=2), MadePlan(JointPlan(Tracks.empty()), None, {}, 0.1, 0.1)
    memo.keep(b"first", made)
    memo.keep(b"second", made)
    assert memo.get(b"first") is made
    memo.keep(b"third", made)
    assert memo.get(b"second") is None
    assert memo.get(b"first") is made
    assert memo.get(b"third") is made


def test_random_numbers_go_on_where_the_plan_left_them(scene: SeedScene, road: RoadMap) -> None:
    class Drawing:
        """A policy that moves no vehicle, but draws random numbers."""

        def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> int:
            return int(rng.integers(100))

        def plan(
            self,
            road: RoadMap,
            scene: Scene,
            memory: int,
            rng: np.random.Generator,
        ) -> tuple[JointPlan, int]:
            return JointPlan(Tracks.empty(12)), memory + int(rng.integers(100))

    memo, ends = memo_of(), []
    for _ in range(2):
        rng, source = np.random.default_rng(4), PlanSource(Drawing(), memo)
        now = Scene(scene.history, 0, np.zeros(scene.history.agents, dtype=np.bool_), ((),), {})
        source.start(road, now, scene.log, rng)
        source.plan(road, now, rng, "background")
        ends.append((source.memory, int(rng.integers(2**62)), source.spared_cpu_s > 0.0))
    assert ends[0][:2] == ends[1][:2]
    assert [end[2] for end in ends] == [False, True]


class Nothing:
    """A policy that returns no plan."""

    def start(self, *_: object) -> None:
        return None

    def plan(self, *_: object) -> tuple[None, int]:
        return None, 1


def test_what_is_no_plan_is_told_by_its_types(scene: SeedScene, road: RoadMap) -> None:
    policy: Any = Nothing()
    record, _ = episode(scene, road, make_target("lane_graph", SOUND), policy, 1.0).run()
    assert record.failure is not None
    assert "returned (NoneType, int), not (JointPlan, memory)" in record.failure.message
