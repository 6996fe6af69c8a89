"""What may be set on the learned targets."""

from __future__ import annotations

from pydantic import Field

from advdiff_sumo.config import Options


class LearnedOptions(Options):
    """Options of every learned target.

    Attributes:
        weights: a file of networks, or the name of shipped ones; empty: the usual ones.
        device: "auto": a GPU where there is one, else the CPU; or a name that PyTorch knows.
        agents: road users that the networks see, the nearest ones.
        route: whether the model's speeds are also tried along the route's lanes; without it the target drives
            where the model would go, which knows no route.
        brakes: whether braking by 2, 4 and 8 m/s² is tried where it would collide in every sample.
    """

    weights: str = ""
    device: str = "auto"
    agents: int = Field(16, ge=2, le=64)
    route: bool = True
    brakes: bool = True


class SimNetPlannerOptions(LearnedOptions):
    """Options of the target ``simnet``, which draws nothing."""


class TrafficSimPlannerOptions(LearnedOptions):
    """Options of the target ``trafficsim``.

    Attributes:
        draws: joint futures that are drawn from the prior beside that of its mean; 0: the mean alone.
    """

    draws: int = Field(7, ge=0, le=63)


class DiffusionPlannerOptions(LearnedOptions):
    """Options of the target ``diffusion``.

    Attributes:
        samples: joint futures that are drawn.
        steps: denoising steps.
        begin: share of the noise schedule at which they begin, see ``diffusion.sampler.Sampling``.
        persistence: how much of the target's starting noise, and so of its intention, is kept from plan to plan.
    """

    samples: int = Field(8, ge=1, le=64)
    steps: int = Field(5, ge=1, le=1000)
    begin: float = Field(0.9, gt=0.0, le=1.0)
    persistence: float = Field(0.9, ge=0.0, le=1.0)
