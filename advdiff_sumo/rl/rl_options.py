"""Options of the attacker's environment and of its training."""

from __future__ import annotations

from typing import Any, Self

from pydantic import Field, model_validator

from advdiff_sumo.config import Options
from advdiff_sumo.sim.sim_options import SceneOptions
from advdiff_sumo.traffic.rl.prior import PriorName


class RewardWeights(Options):
    """Weights of the reward's terms, per model step of 0.5 s; see ``rl.adversary_reward``.

    Attributes:
        hit: the attacker and the target collide.
        hit_by_other: the target collides with another road user.
        near: nearness to the target: 1 at contact, 1/e at ``near_m``.
        near_m: gap to the target at which nearness is 1/e.
        touch: the attacker collides with a road user other than the target.
        off_road: share of the attacker's box off the road.
        jerk: squared jerk in units of 10 m/s³, at most 4.
        align: squared deviation from the behaviour model's action.
    """

    hit: float = 10.0
    hit_by_other: float = 3.0
    near: float = 0.2
    near_m: float = Field(5.0, gt=0.0)
    touch: float = 4.0
    off_road: float = 2.0
    jerk: float = 0.05
    align: float = 0.05


class AdversaryOptions(Options):
    """Options of ``advdiff_sumo/Adversary-v0``.

    Attributes:
        nets: nets, one of which is drawn for each episode.
        targets: targets, one of which is drawn for each episode.
        scenes: number of seed scenes on each net; they are made when they are first drawn, and kept.
        scene_seed: seed of those scenes.
        horizon_s: longest duration of an episode.
        prior: the behaviour model: "simnet", or "traffic": the traffic model at its prior's mean.
        prior_weights: its networks; empty: the shipped ones.
        reward: weights of the reward's terms.
        scene: how seed scenes are found.
    """

    nets: tuple[str, ...] = Field(("downtown",), min_length=1)
    targets: tuple[str, ...] = Field(("IDM",), min_length=1)
    scenes: int = Field(40, ge=1)
    scene_seed: int = Field(0, ge=0)
    horizon_s: float = Field(15.0, ge=0.5, le=600.0, multiple_of=0.5)
    prior: PriorName = "simnet"
    prior_weights: str = ""
    reward: RewardWeights = RewardWeights()
    scene: SceneOptions = SceneOptions()


class PpoOptions(Options):
    """Hyper-parameters of PPO (Schulman et al. 2017, arXiv:1707.06347), named as in stable-baselines3.

    Attributes:
        learning_rate: learning rate of Adam.
        n_steps: steps of each environment between two updates.
        batch_size: steps in a minibatch.
        n_epochs: passes over the collected steps.
        gamma: discount per step of 0.5 s.
        gae_lambda: λ of the generalised advantage estimate.
        clip_range: range to which the probability ratio is clipped.
        ent_coef: weight of the entropy.
        target_kl: Kullback-Leibler divergence from the previous policy at which an update ends.
        log_std: initial logarithm of the exploration's standard deviation, in units of the action.
        hidden: widths of the hidden layers of actor and critic.
    """

    learning_rate: float = Field(3e-4, gt=0.0)
    n_steps: int = Field(256, ge=2)
    batch_size: int = Field(64, ge=2)
    n_epochs: int = Field(8, ge=1)
    gamma: float = Field(0.97, gt=0.0, lt=1.0)
    gae_lambda: float = Field(0.95, ge=0.0, le=1.0)
    clip_range: float = Field(0.2, gt=0.0)
    ent_coef: float = Field(0.0, ge=0.0)
    target_kl: float = Field(0.03, gt=0.0)
    log_std: float = Field(-1.0, ge=-5.0, le=1.0)
    hidden: tuple[int, ...] = (64, 64)

    @model_validator(mode="after")
    def _fit(self) -> Self:
        """Refuse a batch size that does not divide the collected steps."""
        if self.n_steps % self.batch_size:
            raise ValueError(f"n_steps = {self.n_steps} is no multiple of batch_size = {self.batch_size}")
        return self


def adversary_options(values: dict[str, Any]) -> AdversaryOptions:
    """Return checked options; a single net or target may be given as plain text.

    Raises:
        ConfigError: an option has no such name or value.
    """
    listed = {
        key: (value,) if key in ("nets", "targets") and isinstance(value, str) else value
        for key, value in values.items()
    }
    return AdversaryOptions.parse(listed, "options of the environment")
