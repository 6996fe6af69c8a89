"""Properties of the policy that hold for all weights: small untrained networks on a shipped net."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from advdiff_sumo.core.errors import ConfigError, SceneError, WeightsError
from advdiff_sumo.core.scene import AgentClass, Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.bundle import load_bundle
from advdiff_sumo.models.reward import load_reward, save_reward
from advdiff_sumo.models.view import MOST_AGENTS, look
from advdiff_sumo.traffic.background_plan import PlausiblePlan, plausible_plan
from advdiff_sumo.traffic.diffusion import diffusion_policy
from advdiff_sumo.traffic.diffusion.diffusion_options import DiffusionOptions
from advdiff_sumo.traffic.diffusion.diffusion_policy import DiffusionMemory, DiffusionTraffic
from advdiff_sumo.traffic.diffusion.draw import draw_plan
from advdiff_sumo.traffic.diffusion.guidance import ALPHA
from advdiff_sumo.traffic.manoeuvres.agenda import Agenda
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.intensity import Intensity
from advdiff_sumo.traffic.policy_check import check_policy
from advdiff_sumo.traffic.policy_registry import make_policy

Street = Callable[..., Scene]
PLACES = [(60.0, 0.0), (75.0, 0.0), (45.0, 0.0), (90.0, 0.0), (30.0, 0.0)]
SPEEDS = [8.0, 7.0, 9.0, 6.0, 8.0]


def planned(
    policy: DiffusionTraffic, road: RoadMap, scene: Scene, seed: int = 3
) -> tuple[Tracks, DiffusionMemory]:
    memory = policy.start(road, scene, None, np.random.default_rng(0))
    plan, memory = policy.plan(road, scene, memory, np.random.default_rng(seed))
    return plan.tracks, memory


def latents(policy: DiffusionTraffic, road: RoadMap, scene: Scene) -> np.ndarray:
    view = look(road, scene)
    drawn = draw_plan(policy.networks, policy.options, view, {}, {}, 5)
    return drawn.latents.numpy()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"guide": "none"},
        {"guide": "reward-only"},
        {"licence": "reckless", "attack": "rear-end", "attackers": 3, "strength": 1.0},
        {"samples": 3, "eta": 1.0, "family": "printed", "steps": 3},
    ],
)
def test_it_keeps_the_contract(
    options: dict[str, Any], weights: str, downtown: RoadMap, street: Street
) -> None:
    policy = make_policy("diffusion", {"weights": weights, **options})
    assert check_policy(policy, downtown, street(PLACES, SPEEDS), None) == []


def test_the_guide_uses_the_junction_term_for_oncoming() -> None:
    assert DiffusionOptions(attack="oncoming").attack_term == DiffusionOptions(attack="crossing").attack_term


def test_a_reckless_attack_has_no_prescribed_severity() -> None:
    assert DiffusionOptions(braking_mps2=4.0).intensity == Intensity(braking_mps2=4.0)
    with pytest.raises(ConfigError, match="spare_gap_m: a reckless attack has no prescribed severity"):
        DiffusionOptions.parse({"licence": "reckless", "spare_gap_m": 3.0}, "options")


def test_a_plan_is_six_seconds_of_every_movable_vehicle(
    weights: str, downtown: RoadMap, street: Street
) -> None:
    scene = street(PLACES, SPEEDS)
    tracks, memory = planned(DiffusionTraffic(weights=weights), downtown, scene)
    assert set(tracks.ids) == {"v1", "v2", "v3", "v4"}
    assert (tracks.steps, tracks.dt_s, tracks.t0_s) == (12, 0.5, 0.5)
    assert set(memory.noise) == set(scene.history.ids)


def test_same_memory_and_random_numbers_same_bytes(weights: str, downtown: RoadMap, street: Street) -> None:
    scene = street(PLACES, SPEEDS)
    first, _ = planned(DiffusionTraffic(weights=weights, strength=1.0), downtown, scene)
    again, _ = planned(DiffusionTraffic(weights=weights, strength=1.0), downtown, scene)
    other, _ = planned(DiffusionTraffic(weights=weights, strength=1.0), downtown, scene, seed=4)
    assert first.xy_m.tobytes() == again.xy_m.tobytes()
    assert first.xy_m.tobytes() != other.xy_m.tobytes()


def test_strength_0_equals_no_guide(weights: str, downtown: RoadMap, street: Street) -> None:
    scene = street(PLACES, SPEEDS)
    natural, _ = planned(DiffusionTraffic(weights=weights, guide="none", strength=1.0), downtown, scene)
    zero, _ = planned(DiffusionTraffic(weights=weights, strength=0.0), downtown, scene)
    full, _ = planned(DiffusionTraffic(weights=weights, strength=1.0), downtown, scene)
    assert natural.xy_m.tobytes() == zero.xy_m.tobytes()
    assert natural.xy_m.tobytes() != full.xy_m.tobytes()


@pytest.mark.parametrize(
    ("guide", "attack"), [("reward", "any"), ("reward", "brake"), ("reward-only", "any")]
)
def test_only_attackers_are_shifted(
    guide: str, attack: str, uncoupled: str, downtown: RoadMap, street: Street
) -> None:
    """One attacker: all other latents are bit-identical."""
    scene = street(PLACES, SPEEDS)
    view = look(downtown, scene)
    options = {"weights": uncoupled, "attack": attack, "attackers": 1, "strength": 1.0}
    policy = DiffusionTraffic(**options, guide=guide)
    drawn = draw_plan(policy.networks, policy.options, view, {}, {}, 5)
    natural = latents(DiffusionTraffic(**options, guide="none"), downtown, scene)
    changed = (drawn.latents.numpy() != natural).any(axis=1)
    assert [name for name, yes in zip(view.ids, changed, strict=True) if yes] == list(drawn.attackers)
    assert len(drawn.attackers) == 1


def test_the_reward_model_alone_knows_no_kinds_of_attack(
    weights: str, downtown: RoadMap, street: Street
) -> None:
    """Both kinds choose the same of two followers of the target; with the cost terms they differ."""
    scene = street(PLACES[:3], SPEEDS[:3])

    def of(guide: str, attack: str) -> bytes:
        policy = DiffusionTraffic(
            weights=weights, licence="reckless", guide=guide, attack=attack, attackers=1
        )
        tracks, memory = planned(policy, downtown, scene)
        assert tuple(memory.shifts) == ("v1",)
        return tracks.xy_m.tobytes()

    assert of("reward-only", "any") == of("reward-only", "brake")
    assert of("reward", "any") != of("reward", "brake")


def test_attackers_stay_attackers(weights: str, downtown: RoadMap, street: Street) -> None:
    scene = street(PLACES, SPEEDS)
    policy = DiffusionTraffic(weights=weights, licence="reckless", attackers=1)
    _, memory = planned(policy, downtown, scene)
    (chosen,) = memory.shifts
    other = next(name for name in ("v1", "v2") if name != chosen)
    kept = replace(memory, shifts={other: np.zeros(8)}, plan=None)
    _, after = policy.plan(downtown, scene, kept, np.random.default_rng(3))
    assert tuple(after.shifts) == (other,)


def test_an_attack_continues_from_the_previous_shift(weights: str, downtown: RoadMap, street: Street) -> None:
    """The same scene planned repeatedly: shifts grow to twice that of a single plan, and no further."""
    scene = street(PLACES, SPEEDS)
    policy = DiffusionTraffic(weights=weights, strength=0.5, attackers=1)
    memory, lengths = policy.start(downtown, scene, None, np.random.default_rng(3)), []
    for _ in range(8):
        _, memory = policy.plan(downtown, scene, replace(memory, plan=None), np.random.default_rng(3))
        (shift,) = memory.shifts.values()
        lengths.append(float(np.linalg.norm(shift)))
    most = 2.0 * 0.5 * ALPHA * 0.3
    assert lengths[0] <= 0.5 * most + 1e-5
    assert lengths[-1] > 1.2 * lengths[0]
    assert max(lengths) <= most + 1e-5


def test_temperature_scales_the_starting_noise(weights: str, downtown: RoadMap, street: Street) -> None:
    """At 0 all seeds draw the same plan; the default is 1 for reckless plans, and less otherwise."""
    view, drawn = look(downtown, street(PLACES, SPEEDS)), {}
    for temperature in (0.0, 0.4, 1.0, None):
        policy = DiffusionTraffic(weights=weights, guide="none", temperature=temperature)
        drawn[temperature] = [
            draw_plan(policy.networks, policy.options, view, {}, {}, seed).latents.numpy() for seed in (1, 2)
        ]
    apart = {name: float(np.abs(one - two).mean()) for name, (one, two) in drawn.items()}
    assert apart[0.0] == 0.0
    assert 0.0 < apart[0.4] < apart[1.0]
    assert np.array_equal(drawn[None][0], drawn[0.4][0])
    assert DiffusionTraffic(weights=weights, licence="reckless").options.noise == 1.0


def test_the_plan_does_not_depend_on_the_origin_of_the_net(
    weights: str, networks: Path, downtown: RoadMap, street: Street, tmp_path: Path
) -> None:
    """The same net shifted by hundreds of metres: the plan is the same, shifted.

    Up to where the road's edge is cut into pieces, which these random weights make much of, and where the safeguard
    then comes in or not: so most of eight plans have to agree.
    """
    shift = np.array([250.0, -125.0])
    scene = street(PLACES, SPEEDS)
    there = replace(scene, history=replace(scene.history, xy_m=scene.history.xy_m + shift))
    moved = RoadMap.read(_shifted(networks / "downtown.net.xml", tmp_path, shift))
    policy = DiffusionTraffic(weights=weights, guide="none", temperature=1.0)
    away_m, faster_mps = [], []
    for seed in range(8):
        one, two = planned(policy, downtown, scene, seed)[0], planned(policy, moved, there, seed)[0]
        away_m.append(np.abs(two.xy_m - shift - one.xy_m).max())
        faster_mps.append(np.abs(two.speed_mps - one.speed_mps).max())
    assert np.median(away_m) < 0.1
    assert np.median(faster_mps) < 0.03


def _shifted(net: Path, folder: Path, shift: np.ndarray) -> Path:
    """Write *net* with every coordinate moved."""

    def move(found: re.Match[str]) -> str:
        points = [np.array([float(x) for x in p.split(",")]) for p in found[2].split()]
        return (
            f'{found[1]}="' + " ".join(f"{p[0] + shift[0]:.4f},{p[1] + shift[1]:.4f}" for p in points) + '"'
        )

    text = re.sub(r'(\bshape)="([^"]+)"', move, net.read_text())
    for axis, name in enumerate("xy"):
        text = re.sub(
            rf'(<junction [^>]*?\b{name})="([^"]+)"',
            lambda m, axis=axis: f'{m[1]}="{float(m[2]) + shift[axis]:.4f}"',
            text,
        )
    path = folder / "moved.net.xml"
    path.write_text(text)
    return path


def test_short_histories_and_new_vehicles(weights: str, downtown: RoadMap, street: Street) -> None:
    scene = street(PLACES, SPEEDS)
    history = scene.history.window(3, 5)
    valid = history.valid.copy()
    valid[2, 0] = False
    history = replace(
        history,
        valid=valid,
        xy_m=np.where(valid[..., None], history.xy_m, np.nan),
        yaw_rad=np.where(valid, history.yaw_rad, np.nan),
        speed_mps=np.where(valid, history.speed_mps, np.nan),
    )
    short = replace(scene, history=history)
    view = look(downtown, short)
    assert view.batch.past_valid[0].sum(1).tolist() == [2 - (name == "v2") for name in view.ids]
    tracks, _ = planned(DiffusionTraffic(weights=weights), downtown, short)
    assert np.isfinite(tracks.xy_m).all()


def test_the_view_of_a_scene(downtown: RoadMap, street: Street) -> None:
    """The target first, every movable vehicle at any distance, and the nearest of the others."""
    places = [(100.0, 0.0), *((100.0 + 2.0 * k, 0.0) for k in range(1, 41))]
    scene = street(places, [0.0] * 41)
    movable = np.zeros(41, dtype=np.bool_)
    movable[[5, 40]] = True
    view = look(downtown, replace(scene, movable=movable))
    assert len(view.rows) == MOST_AGENTS
    assert view.rows[0] == 0
    assert set(view.rows.tolist()) == {*range(MOST_AGENTS - 1), 40}
    assert [view.ids[k] for k in np.flatnonzero(view.moved)] == ["v5", "v40"]


def test_pedestrians_and_vehicles_that_are_not_movable_get_no_plan(
    weights: str, downtown: RoadMap, street: Street
) -> None:
    scene = street(PLACES, SPEEDS)
    classes = scene.history.classes.copy()
    classes[1] = AgentClass.PEDESTRIAN
    movable = scene.movable.copy()
    movable[2] = False
    changed = replace(scene, history=replace(scene.history, classes=classes), movable=movable)
    tracks, _ = planned(DiffusionTraffic(weights=weights), downtown, changed)
    assert set(tracks.ids) == {"v3", "v4"}


def test_no_vehicle_to_move(weights: str, downtown: RoadMap, street: Street) -> None:
    scene = street(PLACES, SPEEDS)
    tracks, _ = planned(
        DiffusionTraffic(weights=weights), downtown, replace(scene, movable=np.zeros(5, dtype=np.bool_))
    )
    assert tracks.agents == 0


def test_manoeuvres_take_turns_without_a_vehicle_to_move(
    weights: str, downtown: RoadMap, street: Street
) -> None:
    """After 10 s the turn of the cut-out, which can begin at 0 s alone, is over: a leader comes in for a stop.

    1.5 s and 8 m ahead of a target with 8 m/s are less than the 36 m that a leader keeps from it at least.
    """
    scene = street(PLACES[:1], SPEEDS[:1])
    scene = replace(scene, history=scene.history.shifted(10.0))
    policy = DiffusionTraffic(weights=weights)
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    assert memory.commitments is not None
    agenda = Agenda(("cut-out", "hard-stop"), crosses_any_time=False)
    memory = replace(memory, commitments=replace(memory.commitments, agenda=agenda))
    plan, memory = policy.plan(downtown, scene, memory, np.random.default_rng(3))
    assert plan.tracks.ids == ("staged-0",)
    ahead = float(np.linalg.norm(plan.tracks.xy_m[0, 0] - scene.history.xy_m[0, -1]))
    assert ahead == pytest.approx(36.0 + 0.5 * plan.tracks.speed_mps[0, 0], abs=0.5)
    assert memory.commitments is not None
    assert memory.commitments.agenda.now == "hard-stop"
    assert memory.commitments.since_s == {"v0": 10.0}


def test_standing_vehicles_stay_exactly_where_they_are(
    weights: str, downtown: RoadMap, street: Street
) -> None:
    """A queue behind the target: no vehicle may creep, whatever the networks predict."""
    scene = street([(60.0, 0.0), (53.0, 0.0), (46.0, 0.0)], [0.0, 0.0, 0.0])
    policy = DiffusionTraffic(weights=weights, guide="none")
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    tracks = policy.plan(downtown, scene, memory, np.random.default_rng(1))[0].tracks
    for row, name in enumerate(tracks.ids):
        now = scene.history.xy_m[scene.history.index[name], -1]
        gone = np.linalg.norm(tracks.xy_m[row] - now, axis=-1)
        assert gone[2] == 0.0 or gone[2] > 0.3  # still, or on its way


def test_a_plan_is_driven_for_replan_steps(weights: str, downtown: RoadMap, street: Street) -> None:
    scene = street(PLACES, SPEEDS)
    policy = DiffusionTraffic(weights=weights, replan=2)
    first, memory = planned(policy, downtown, scene)
    later = replace(scene, history=scene.history.shifted(0.5))
    second, memory = policy.plan(downtown, later, memory, np.random.default_rng(9))
    np.testing.assert_array_equal(second.tracks.xy_m, first.xy_m[:, 1:])
    assert second.tracks.t0_s == 1.0
    third, _ = policy.plan(
        downtown, replace(scene, history=scene.history.shifted(1.0)), memory, np.random.default_rng(9)
    )
    assert third.tracks.steps == 12
    # a vehicle that has come into reach gets a plan at once
    _, memory = planned(policy, downtown, replace(scene, movable=np.array([False, True, True, True, False])))
    fresh, _ = policy.plan(downtown, later, memory, np.random.default_rng(9))
    assert "v4" in fresh.tracks.ids


def test_model_steps_are_counted_if_plans_are_farther_apart(
    weights: str, downtown: RoadMap, street: Street
) -> None:
    """A call each second: a plan is driven for four half seconds, and a new one is made after them."""
    scene = street(PLACES, SPEEDS)
    policy = DiffusionTraffic(weights=weights, replan=4)
    first, memory = planned(policy, downtown, scene)
    for at_s, steps in ((1.0, 10), (2.0, 12)):
        later = replace(scene, history=scene.history.shifted(at_s))
        plan, memory = policy.plan(downtown, later, memory, np.random.default_rng(9))
        assert (plan.tracks.t0_s, plan.tracks.steps) == (at_s + 0.5, steps)
        if at_s == 1.0:
            np.testing.assert_array_equal(plan.tracks.xy_m, first.xy_m[:, 2:])


def test_sumo_takes_over_at_the_end_of_the_road(weights: str, downtown: RoadMap) -> None:
    dead = next(
        x
        for x in sorted(downtown.lanes.values(), key=lambda x: x.id)
        if not x.is_internal and not x.successors and x.permits("passenger") and x.length_m > 60.0
    )
    s = np.array([dead.length_m - 40.0, dead.length_m - 10.0])
    xy, yaw = dead.line.at(s[:, None] + np.zeros(5))
    history = Tracks(
        ids=("target", "leaves"),
        classes=np.zeros(2, dtype=np.int64),
        size_m=np.tile([4.6, 1.9], (2, 1)),
        xy_m=xy,
        yaw_rad=yaw,
        speed_mps=np.full((2, 5), 8.0),
        valid=np.ones((2, 5), dtype=np.bool_),
        t0_s=-2.0,
        dt_s=0.5,
    )
    scene = Scene(history, 0, np.array([False, True]), ((), ()), {})
    assert planned(DiffusionTraffic(weights=weights), downtown, scene)[0].agents == 0


# --- files and options -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"strength": 1.5}, "strength = 1.5"),
        ({"attack": "ram"}, "attack = 'ram'"),
        ({"steps": 500}, "the networks were trained with 100"),
        ({"device": "abacus"}, "device = 'abacus' cannot be used"),
        ({"strenght": 1.0}, "strength"),
    ],
)
def test_wrong_options(options: dict[str, Any], said: str, weights: str) -> None:
    with pytest.raises(ConfigError, match=said):
        make_policy("diffusion", {"weights": weights, **options})


def test_missing_weights(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="no such file"):
        DiffusionTraffic(weights=str(tmp_path / "none.safetensors"))


def test_a_reward_model_from_another_file(
    weights: str, downtown: RoadMap, street: Street, tmp_path: Path
) -> None:
    bundle = load_bundle(Path(weights))
    for weight in bundle.reward.parameters():
        weight.data *= -2.0
    path = tmp_path / "q.safetensors"
    save_reward(bundle.reward, path)
    again = load_reward(path, bundle.options.model)
    for mine, theirs in zip(again.parameters(), bundle.reward.parameters(), strict=True):
        assert torch.equal(mine, theirs)
    scene = street(PLACES, SPEEDS)
    one = latents(DiffusionTraffic(weights=weights, strength=1.0), downtown, scene)
    two = latents(DiffusionTraffic(weights=weights, strength=1.0, reward=str(path)), downtown, scene)
    assert (one != two).any()
    with pytest.raises(WeightsError, match="not of the format"):
        DiffusionTraffic(weights=weights, reward=weights)
    with pytest.raises(WeightsError, match="warmup"):
        DiffusionTraffic(weights=weights, reward=str(tmp_path / "none"))


def test_another_spacing_of_histories(weights: str, downtown: RoadMap, street: Street) -> None:
    scene = street(PLACES, SPEEDS)
    coarse = replace(scene, history=replace(scene.history, dt_s=1.0))
    with pytest.raises(SceneError, match=r"sim\.model_step_s"):
        planned(DiffusionTraffic(weights=weights), downtown, coarse)


@pytest.mark.parametrize(
    ("attack", "in_position"), [("brake", {"v1", "v3"}), ("rear-end", {"v2", "v4"}), ("head-on", set())]
)
def test_a_plan_names_the_vehicles_in_position_for_the_attack(
    attack: str, in_position: set[str], weights: str, downtown: RoadMap, street: Street
) -> None:
    """Two vehicles ahead of the target in its lane, two behind, none oncoming."""
    policy = DiffusionTraffic(weights=weights, licence="reckless", attack=attack)
    scene = street(PLACES, SPEEDS)
    plan, _ = policy.plan(downtown, scene, DiffusionMemory(), np.random.default_rng(3))
    assert plan.attack is not None
    assert plan.attack.kind == attack
    assert set(plan.attack.in_position) == in_position


@pytest.mark.parametrize(("licence", "guided"), [("lawful", {}), ("reckless", {"v1": "guided"})])
def test_a_vehicle_whose_guided_plan_is_not_driven_does_not_count_as_guided(
    licence: str, guided: dict[str, str], weights: str, downtown: RoadMap, street: Street
) -> None:
    """At 5.5 m/s after a manoeuvre it follows its lane until it reaches 6 m/s, unless it is reckless."""
    scene = street([(60.0, 0.0), (80.0, 0.0)], [5.0, 5.5])
    policy = DiffusionTraffic(weights=weights, licence=licence, staged=0)
    rested = Commitments.start("any", np.random.default_rng(0))
    memory = DiffusionMemory(commitments=replace(rested, rested_s={"v1": 9.0}))
    plan, memory = policy.plan(downtown, scene, memory, np.random.default_rng(3))
    assert set(memory.shifts) == {"v1"}
    assert plan.attack is not None
    assert plan.attack.manoeuvres == guided
    assert plan.attack.in_position == tuple(guided)


def test_natural_traffic_has_no_attack(weights: str, downtown: RoadMap, street: Street) -> None:
    policy = DiffusionTraffic(weights=weights, guide="none")
    plan, _ = policy.plan(downtown, street(PLACES, SPEEDS), DiffusionMemory(), np.random.default_rng(3))
    assert plan.attack is None


@pytest.mark.parametrize("licence", ["lawful", "careless", "reckless"])
def test_natural_traffic_keeps_the_rules_of_its_licence(
    licence: str, weights: str, downtown: RoadMap, street: Street, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = []

    def told(*args: Any) -> PlausiblePlan:
        given.append(args[-1].licence)
        return plausible_plan(*args)

    monkeypatch.setattr(diffusion_policy, "plausible_plan", told)
    planned(
        DiffusionTraffic(weights=weights, guide="none", licence=licence), downtown, street(PLACES, SPEEDS)
    )
    assert set(given) == {licence}


def test_the_guide_has_no_term_for_a_cut_out(weights: str, downtown: RoadMap, street: Street) -> None:
    """It is a lawful manoeuvre only: a vehicle guided to the target is not yet in a position for it."""
    policy = DiffusionTraffic(weights=weights, licence="lawful", attack="cut-out")
    scene = street(PLACES, SPEEDS)
    memory = policy.start(downtown, scene, None, np.random.default_rng(0))
    plan, memory = policy.plan(downtown, scene, memory, np.random.default_rng(3))
    assert memory.shifts
    assert plan.attack is not None
    assert plan.attack.in_position == ()
