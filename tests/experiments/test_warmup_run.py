"""Warm-up on a shipped net with small untrained networks: what it learns from, and that only Q changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open

from advdiff_sumo.core.errors import ConfigError, EpisodeFailure
from advdiff_sumo.experiments.warmup_run import DrawnLatents, WarmedUp, experiences, warm_up
from advdiff_sumo.models.bundle import Bundle, BundleOptions, load_bundle, new_bundle, save_bundle
from advdiff_sumo.models.reward import load_reward, save_reward
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.traffic.diffusion.diffusion_policy import DiffusionTraffic
from advdiff_sumo.training.presets import RewardOptions
from tests.diffusion.test_fast import scene
from tests.traffic.small_networks import MODEL

STEPS = 7


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "small.safetensors"
    save_bundle(new_bundle(BundleOptions.parse({"model": MODEL})), path, ())
    return path


def options(weights: Path, **background: object) -> RunOptions:
    return RunOptions.parse(
        {
            "net": "motorway",
            "target": "Krauss",
            "background": "diffusion",
            "background_options": {"weights": str(weights), "steps": 2, **background},
            "horizon_s": 3.0,
            "scene": {"warmup_s": 10.0, "min_neighbours": 1, "scenes_per_warmup": 3},
        }
    )


@pytest.fixture(scope="module")
def warmed(weights: Path) -> tuple[WarmedUp, list[int]]:
    told: list[int] = []
    return warm_up(options(weights), STEPS, told.append), told


def test_it_learns_from_as_many_plans_as_asked(warmed: tuple[WarmedUp, list[int]]) -> None:
    """Plans at 0, 0.5, …, 2.5 s of a 3 s episode; the last one's two model steps reach beyond its end."""
    done, told = warmed
    assert done.steps == STEPS
    assert told[-1] == STEPS
    assert told == sorted(told)
    assert done.episodes == len(told)
    assert len(done.losses) == 2 * STEPS
    assert np.isfinite(done.losses).all()


def test_plans_know_the_drive_that_followed(weights: Path) -> None:
    """As far as the record goes: 3 s of a 3 s episode for the plan at 0 s, nothing for the later ones."""
    run = Run.prepare(options(weights))
    policy = run.policy
    assert isinstance(policy, DiffusionTraffic)
    plans: list[DrawnLatents] = []
    policy.listener = lambda view, drawn: plans.append(DrawnLatents(view, drawn.latents))
    record, _ = run.episode(0, next(iter(run.seed_scenes()))).run()
    made = list(experiences(record, plans, RewardOptions()))
    assert record.end == "horizon"
    assert [int(one.state.future_valid.sum()) for one in made] == [6, *[0] * (len(made) - 1)]
    tracks, view = record.tracks, plans[0].view
    step = round((view.scene.time_s + 3.0 - tracks.t0_s) / tracks.dt_s)
    last = tracks.xy_m[tracks.index[view.ids[0]], step]
    drive = made[0].state.future[0, 0, 5, :2].numpy() + view.now.xy_m[0, -1]
    assert np.allclose(drive, last, atol=1e-3)


def test_only_the_reward_model_changes(warmed: tuple[WarmedUp, list[int]], weights: Path) -> None:
    before = load_bundle(weights)
    after = load_bundle(weights)
    for name, value in _others(before).items():
        assert torch.equal(value, _others(after)[name])
    pairs = zip(warmed[0].reward.parameters(), before.reward.parameters(), strict=True)
    assert any(not torch.equal(mine, theirs) for mine, theirs in pairs)


def _others(bundle: Bundle) -> dict[str, torch.Tensor]:
    return {name: value for name, value in bundle.tensors().items() if not name.startswith("reward.")}


def test_the_same_again_is_the_same_to_the_bit(warmed: tuple[WarmedUp, list[int]], weights: Path) -> None:
    again = warm_up(options(weights), STEPS, [].append)
    assert again.losses == warmed[0].losses
    for mine, theirs in zip(again.reward.parameters(), warmed[0].reward.parameters(), strict=True):
        assert torch.equal(mine, theirs)


def test_the_guide_follows_the_new_q(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its weights are read when a guide's are made, so that they have to be read again after each episode."""
    made: list[Run] = []
    prepare = Run.prepare

    def remember(given: RunOptions) -> Run:
        made.append(prepare(given))
        return made[0]

    monkeypatch.setattr(Run, "prepare", remember)
    done = warm_up(options(weights), STEPS, [].append)
    policy = made[0].policy
    assert isinstance(policy, DiffusionTraffic)
    batch, target = scene(scenes=2, agents=4), torch.tensor([0, 0])
    generator = torch.Generator().manual_seed(3)
    sizes = done.reward.options
    h, z, mu = (torch.randn(2, 4, n, generator=generator) for n in (sizes.hidden, sizes.latent, sizes.latent))
    state = done.reward.prepare(h, z, batch, target)
    guided_by = policy.networks.reward(state)
    assert torch.equal(guided_by(mu), done.reward.value_of(state, mu))
    assert not torch.equal(guided_by(mu), load_bundle(weights).reward.value_of(state, mu))


def test_a_file_holds_q_alone(warmed: tuple[WarmedUp, list[int]], weights: Path, tmp_path: Path) -> None:
    path = tmp_path / "q.safetensors"
    save_reward(warmed[0].reward, path, {"target": "Krauss"})
    bundle = load_bundle(weights)
    with safe_open(str(path), framework="pt") as file:
        assert set(file.keys()) == set(bundle.reward.state_dict())
        assert "Krauss" in file.metadata()["advdiff"]
    for mine, theirs in zip(
        load_reward(path, bundle.options.model).parameters(), warmed[0].reward.parameters(), strict=True
    ):
        assert torch.equal(mine, theirs)


def test_episodes_that_teach_nothing_end_it(weights: Path) -> None:
    short = options(weights).model_copy(update={"horizon_s": 0.5})
    with pytest.raises(
        EpisodeFailure, match=r"5 episodes that nothing can be learned from; .* longer --horizon"
    ):
        warm_up(short, STEPS, [].append)


@pytest.mark.parametrize("background", [{"guide": "none"}, {"strength": 0.0}])
def test_natural_traffic_teaches_nothing(weights: Path, background: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match="warm-up is for background 'diffusion'"):
        warm_up(options(weights, **background), STEPS, [].append)
