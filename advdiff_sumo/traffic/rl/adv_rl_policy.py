"""The background policy ``adv-rl``: vehicles follow a behaviour model, from which attackers deviate by PPO."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import Field

from advdiff_sumo.config import Options
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.traffic.licence import LicenceName
from advdiff_sumo.traffic.rl.actor import Actor, load_actor
from advdiff_sumo.traffic.rl.prior import Prior, load_prior
from advdiff_sumo.traffic.rl.rl_situation import joint_plan, situation

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap


class AdvRlOptions(Options):
    """Options of ``adv-rl``.

    Attributes:
        weights: file of an actor of ``advdiff-sumo train-rl``; empty: the shipped one.
        prior_weights: networks of the behaviour model, of the kind that the actor names; empty: the shipped ones.
        strength: share of the actor's deviation from the behaviour model that is driven; 0: the behaviour model.
        attackers: largest number of simultaneous attackers; the actor was trained with one.
        licence: what attackers may do, as in ``diffusion``: "lawful", "careless", or "reckless", as published.
    """

    weights: str = ""
    prior_weights: str = ""
    strength: float = Field(1.0, ge=0.0, le=1.0)
    attackers: int = Field(2, ge=1, le=8)
    licence: LicenceName = "lawful"

    @property
    def max_attackers(self) -> int:
        """Largest number of attackers; 0 if they would not deviate and a licence might refuse their natural plans."""
        return self.attackers if self.strength > 0.0 or self.licence == "reckless" else 0


@dataclass(frozen=True)
class AdvRlMemory:
    """Memory of the policy.

    Attributes:
        attackers: ids of the previous attackers.
        plan: the previous plan.
    """

    attackers: tuple[str, ...] = ()
    plan: Tracks | None = None


class AdvRl:
    """Adversarial reinforcement learning (the paper's baseline Adv-RL, Sec. IV); options are :class:`AdvRlOptions`.

    Attributes:
        options: the checked options.
        actor: the actor trained by ``advdiff-sumo train-rl``.
        prior: the behaviour model from which it deviates.
    """

    Options: ClassVar[type[AdvRlOptions]] = AdvRlOptions

    @one_thread()
    def __init__(self, **options: Any) -> None:
        """Check the options and read the networks.

        Raises:
            ConfigError: an option has no such name or value.
            WeightsError: the actor or the behaviour model is missing or unusable.
        """
        self.options = AdvRlOptions.parse(options, "options of background 'adv-rl'")
        path = Path(self.options.weights) if self.options.weights else shipped_actor()
        self.actor: Actor = load_actor(path)
        self.prior: Prior = load_prior(self.actor.prior, self.options.prior_weights)

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> AdvRlMemory:  # noqa: ARG002 - the contract
        """Return an empty memory, after the map has made its table of pieces."""
        _ = road.pieces(self.prior.options.map_view)
        return AdvRlMemory()

    @one_thread()
    def plan(
        self,
        road: RoadMap,
        scene: Scene,
        memory: AdvRlMemory,
        rng: np.random.Generator,  # noqa: ARG002 - the contract
    ) -> tuple[JointPlan, AdvRlMemory]:
        """Return the futures of all movable vehicles, 4 s at 2 Hz, without random numbers."""
        options = self.options
        now = situation(road, scene, self.prior, options.max_attackers, memory.attackers, options.licence)
        residuals = options.strength * self.actor.residuals(now.observations)
        plan = joint_plan(road, now, self.prior, residuals, memory.plan, options.licence)
        plan = plan if options.max_attackers else replace(plan, attack=None)
        return plan, AdvRlMemory(now.attackers, plan.tracks)


def shipped_actor() -> Path:
    """Return the path of the shipped actor."""
    return shipped_weights("traffic").with_name("adv_rl.safetensors")
