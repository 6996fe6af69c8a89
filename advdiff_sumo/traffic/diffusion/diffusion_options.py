"""Options of ``diffusion``, in the words of a user."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal, TypeAlias

from pydantic import Field

from advdiff_sumo.config import Options
from advdiff_sumo.models.shipped_weights import shipped_weights

Attack: TypeAlias = Literal["any", "cut-in", "rear-end", "head-on", "junction", "brake"]


class DiffusionOptions(Options):
    """Options of ``diffusion``.

    Attributes:
        strength: how hard attackers are guided against the target; 0 is natural traffic exactly.
        attackers: most vehicles that are guided at a time.
        attack: what they shall do; "any": whatever gets them close.
        guide: "reward": by the reward model and the attack's own terms; "reward-only": by the reward model alone,
            as in the paper; "none": natural traffic.
        steps: denoising steps of a plan.
        family: transition of the denoising, see ``diffusion.sampler``.
        eta: share of fresh noise in each denoising step; the family "printed" has 1.
        persistence: how much of a vehicle's starting noise, and so of its intention, is kept from plan to plan.
        replan: model steps of 0.5 s of a plan that are driven before the next one (the paper's l).
        samples: joint futures drawn at once, of which the most plausible is driven.
        weights: a bundle of networks; empty: the shipped one.
        reward: a reward model of ``advdiff-sumo warmup`` in place of the bundle's; empty: none.
        device: "auto": a GPU where there is one, else the CPU; or a name that PyTorch knows.
    """

    shipped: ClassVar[Literal["traffic", "traj2traj"]] = "traffic"
    strength: float = Field(1.0, ge=0.0, le=1.0)
    attackers: int = Field(2, ge=1, le=8)
    attack: Attack = "any"
    guide: Literal["reward", "reward-only", "none"] = "reward"
    steps: int = Field(5, ge=1, le=1000)
    family: Literal["printed", "consistent"] = "consistent"
    eta: float = Field(0.0, ge=0.0, le=1.0)
    persistence: float = Field(0.9, ge=0.0, le=1.0)
    replan: int = Field(1, ge=1, le=12)
    samples: int = Field(1, ge=1, le=64)
    weights: str = ""
    reward: str = ""
    device: str = "auto"

    @property
    def guided(self) -> bool:
        """Whether anybody is attacked at all."""
        return self.guide != "none" and self.strength > 0.0

    @property
    def path(self) -> Path:
        """The networks' file."""
        return Path(self.weights) if self.weights else shipped_weights(self.shipped)


class Traj2TrajOptions(DiffusionOptions):
    """Options of ``traj2traj``: those of ``diffusion``, less the guide, for networks that diffuse trajectories."""

    shipped: ClassVar[Literal["traffic", "traj2traj"]] = "traj2traj"
    guide: Literal["none"] = "none"
    steps: int = Field(10, ge=1, le=1000)
