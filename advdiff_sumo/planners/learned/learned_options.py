"""Options of the learned targets."""

from __future__ import annotations

from pydantic import Field

from advdiff_sumo.config import Options


class LearnedOptions(Options):
    """Options of every learned target.

    Attributes:
        weights: file of networks, or name of shipped ones; empty: the default ones.
        device: "auto": a GPU if there is one, else the CPU; or a PyTorch device name.
        agents: number of nearest road users that the networks see.
        route: whether the samples' speeds are also tried along the lanes of the route; without it the target goes
            wherever the model drives it, and the model knows no route.
        brakes: whether braking at 2, 4 and 8 m/s² is tried, too.
    """

    weights: str = ""
    device: str = "auto"
    agents: int = Field(16, ge=2, le=64)
    route: bool = True
    brakes: bool = True


class SimNetPlannerOptions(LearnedOptions):
    """Options of the target ``simnet``, which draws no samples."""


class TrafficSimPlannerOptions(LearnedOptions):
    """Options of the target ``trafficsim``.

    Attributes:
        draws: joint futures drawn from the prior besides that of its mean; 0: the mean only.
    """

    draws: int = Field(7, ge=0, le=63)


class DiffusionPlannerOptions(LearnedOptions):
    """Options of the target ``diffusion``.

    Attributes:
        samples: number of joint futures drawn.
        steps: denoising steps.
        begin: share of the noise schedule at which denoising begins, see ``diffusion.sampler.Sampling``.
        persistence: share of the target's starting noise, and so of its intention, that is kept from plan to plan.
    """

    samples: int = Field(8, ge=1, le=64)
    steps: int = Field(5, ge=1, le=1000)
    begin: float = Field(0.9, gt=0.0, le=1.0)
    persistence: float = Field(0.9, ge=0.0, le=1.0)
