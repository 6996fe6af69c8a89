"""Properties of the background policy adv-rl that hold for all weights."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from advdiff_sumo.core.errors import ConfigError, WeightsError
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.stored import write_stored
from advdiff_sumo.traffic import background_plan
from advdiff_sumo.traffic.planning.drawn import Drawn
from advdiff_sumo.traffic.policy_check import check_policy
from advdiff_sumo.traffic.policy_registry import make_policy
from advdiff_sumo.traffic.rl.actor import load_actor, save_actor
from advdiff_sumo.traffic.rl.adv_rl_policy import AdvRl
from advdiff_sumo.traffic.rl.features import FEATURES
from tests.traffic.rl.conftest import actor

Street = Callable[..., Scene]
Files = Callable[[float], str]
PLACES = [(60.0, 0.0), (75.0, 0.0), (45.0, 0.0), (90.0, 0.0)]
SPEEDS = [8.0, 7.0, 9.0, 6.0]


def policy(actor_file: Files, weights: str, shift: float, **options: object) -> AdvRl:
    chosen = {"weights": actor_file(shift), "prior_weights": weights, "licence": "reckless", **options}
    made = make_policy("adv-rl", chosen)
    assert isinstance(made, AdvRl)
    return made


def planned(made: AdvRl, road: RoadMap, scene: Scene) -> Tracks:
    rng = np.random.default_rng(0)
    plan, memory = made.plan(road, scene, made.start(road, scene, None, rng), rng)
    assert len(memory.attackers) == made.options.attackers
    return plan.tracks


def same(a: Tracks, b: Tracks) -> bool:
    return (
        a.ids == b.ids and a.xy_m.tobytes() == b.xy_m.tobytes() and a.yaw_rad.tobytes() == b.yaw_rad.tobytes()
    )


@pytest.mark.parametrize("attackers", [1, 2])
def test_it_keeps_the_contract(
    attackers: int, actor_file: Files, weights: str, downtown: RoadMap, street: Street
) -> None:
    made = policy(actor_file, weights, 0.7, attackers=attackers)
    assert check_policy(made, downtown, street(PLACES, SPEEDS), None) == []


def test_untrained_it_equals_the_behaviour_model(
    actor_file: Files, downtown: RoadMap, street: Street
) -> None:
    """With no training and with strength 0 the plan is the behaviour model's, to the bit; otherwise it is not.

    With the shipped traffic model: what untrained networks plan leaves the road, and the safeguard makes it all one.
    """
    scene = street(PLACES, SPEEDS)
    fresh = planned(policy(actor_file, "", 0.0), downtown, scene)
    off = planned(policy(actor_file, "", 0.7, strength=0.0), downtown, scene)
    trained = planned(policy(actor_file, "", 0.7), downtown, scene)
    assert same(fresh, off)
    assert not same(fresh, trained)
    assert same(trained, planned(policy(actor_file, "", 0.7), downtown, scene))


@pytest.mark.parametrize("licence", ["lawful", "careless"])
def test_with_strength_0_no_licence_changes_the_behaviour_model(
    licence: str, actor_file: Files, weights: str, downtown: RoadMap, street: Street
) -> None:
    """The plan is that of the behaviour model with untrained weights, after the safeguard, without an attacker."""
    scene = street([(60.0, 0.0), (70.0, -2.5), (90.0, 0.0)], [8.0, 4.0, 6.0])
    made = policy(actor_file, weights, 0.7, strength=0.0, licence=licence)
    view, lanes = background_plan.view_and_lanes(downtown, scene, made.prior.options.map_view)
    drawn = Drawn(made.prior.rollout(view.batch), {}, (), torch.zeros(len(view.ids), 0))
    rules = background_plan.Rules(made.options.licence, 0)
    natural = background_plan.plausible_plan(downtown, view, lanes, drawn, (None, 0), rules)
    rng = np.random.default_rng(0)
    plan, memory = made.plan(downtown, scene, made.start(downtown, scene, None, rng), rng)
    assert same(plan.tracks, natural.tracks)
    assert plan.attack is None
    assert memory.attackers == ()


def test_only_the_attacker_deviates(actor_file: Files, downtown: RoadMap, street: Street) -> None:
    scene = street([(60.0, 0.0), (85.0, 0.0), (20.0, 0.0)], [8.0, 8.0, 8.0])
    made = policy(actor_file, "", 0.4, licence="reckless")
    rng = np.random.default_rng(0)
    plan, memory = made.plan(downtown, scene, made.start(downtown, scene, None, rng), rng)
    before = planned(policy(actor_file, "", 0.0), downtown, scene)
    moved = np.abs(plan.tracks.xy_m[:, 0] - before.xy_m[:, 0]).max(axis=-1)
    deviating = {name for name, far in zip(plan.tracks.ids, moved, strict=True) if far > 0.0}
    assert deviating == set(memory.attackers)


def test_the_safeguard_gets_the_previous_plan(
    actor_file: Files, downtown: RoadMap, street: Street, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, rng = street(PLACES, SPEEDS), np.random.default_rng(0)
    made = policy(actor_file, "", 0.4)
    given: list[tuple[Tracks | None, int]] = []
    apply_safeguard = background_plan.apply_safeguard

    def spy(*arguments: Any) -> Any:
        given.append(arguments[4])
        return apply_safeguard(*arguments)

    monkeypatch.setattr(background_plan, "apply_safeguard", spy)
    first, memory = made.plan(downtown, scene, made.start(downtown, scene, None, rng), rng)
    made.plan(downtown, scene, memory, rng)
    assert given[0] == (None, 1)
    assert given[1][0] is first.tracks
    for at_s in (0.5, 1.0):
        made.plan(downtown, replace(scene, history=scene.history.shifted(at_s)), memory, rng)
    assert [steps for _, steps in given[2:]] == [1, 2]


def test_an_actor_is_unchanged_by_saving_and_loading(tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("actor") / "a.safetensors"
    made = actor(0.4)
    save_actor(made, path)
    first = path.read_bytes()
    again = load_actor(path)
    seen = np.random.default_rng(2).normal(size=(5, FEATURES))
    assert again.residuals(seen).tobytes() == made.residuals(seen).tobytes()
    assert (again.prior, again.hidden, again.notes) == (made.prior, made.hidden, made.notes)
    assert (np.abs(made.residuals(100.0 * seen)) <= 1.0).all()
    save_actor(again, path)
    assert path.read_bytes() == first


def test_bad_options_and_files_are_refused(
    actor_file: Files, weights: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    with pytest.raises(ConfigError, match="no option 'attack'; did you mean 'attackers'"):
        make_policy("adv-rl", {"attack": "any"})
    with pytest.raises(WeightsError, match="train it with advdiff-sumo train-rl"):
        make_policy("adv-rl", {"weights": "nowhere.safetensors"})
    with pytest.raises(WeightsError, match="is not of the format advdiff-actor-1"):
        make_policy("adv-rl", {"weights": weights})
    folder = tmp_path_factory.mktemp("bad")
    good = load_actor(Path(actor_file(0.0)))
    header = {"format": "advdiff-actor-1", "hidden": [16], "features": FEATURES, "prior": "traffic"}
    tensors = good.net.state_dict()
    cases = {
        "has no usable header": ({**header, "hidden": None}, tensors),
        f"observes 3 features, this version {FEATURES}": ({**header, "features": 3}, tensors),
        "does not fit its own header": ({**header, "hidden": [8]}, tensors),
        "holds weights that are not numbers": (
            header,
            {k: torch.full_like(v, torch.nan) for k, v in tensors.items()},
        ),
    }
    for problem, (said, held) in cases.items():
        path = folder / "x.safetensors"
        write_stored(path, held, said)
        with pytest.raises(WeightsError, match=re.escape(problem)):
            load_actor(path)


def test_it_drives_without_the_packages_for_training(actor_file: Files, weights: str) -> None:
    code = (
        "import sys\n"
        "sys.modules['gymnasium'] = sys.modules['stable_baselines3'] = None\n"
        "from advdiff_sumo.traffic.policy_registry import make_policy\n"
        f"make_policy('adv-rl', {{'weights': {actor_file(0.7)!r}, 'prior_weights': {weights!r}}})\n"
        "try:\n    import advdiff_sumo.rl\n"
        "except Exception as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install 'advdiff-sumo[rl]'" in done.stdout
