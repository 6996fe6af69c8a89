"""Options of ``diffusion``, in the words of a user."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal, Self, TypeAlias

from pydantic import Field, model_validator

from advdiff_sumo.config import Options
from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.failure_predictor import FORMAT
from advdiff_sumo.models.shipped_weights import ShippedName, find_weights
from advdiff_sumo.models.stored import stored_format
from advdiff_sumo.traffic.attack_names import RECKLESS_ATTACKS, FurtherAttack
from advdiff_sumo.traffic.licence import LicenceName
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference
from advdiff_sumo.traffic.manoeuvres.staging import STAGED

Attack: TypeAlias = Literal[
    "any", "cut-in", "rear-end", "head-on", "junction", "brake", "hard-stop", FurtherAttack
]
LAWFUL_ATTACKS: Mapping[str, tuple[str, str]] = {
    "any": ("any", "any"),
    "cut-in": ("cut-in", "cut-in"),
    "brake": ("hard-stop", "brake"),
    "hard-stop": ("hard-stop", "brake"),
    "junction": ("crossing", "junction"),
    "crossing": ("crossing", "junction"),
    "blocked-lane": ("blocked-lane", "brake"),
    "stop-and-go": ("stop-and-go", "brake"),
    "cut-out": ("cut-out", "any"),
    "queue": ("queue", "any"),
    "oncoming": ("oncoming", "junction"),
    "double": ("double", "any"),
    "slow-merge": ("slow-merge", "any"),
    "pull-out": ("pull-out", "any"),
}
"""Attack → the manoeuvre that it stands for under a licence, and the guide's term that goes with it."""


class DiffusionOptions(Options):
    """Options of ``diffusion``.

    Attributes:
        licence: what attackers may do: "lawful": no traffic rule is broken, and lawful manoeuvres are driven beside
            the guided plans; "careless": smaller gaps; "reckless": anything that moves like a vehicle, as in the paper.
        strength: how hard attackers are guided against the target; 0 is natural traffic exactly.
        attackers: most vehicles that are guided at a time, and most lawful manoeuvres beside them.
        attack: what they shall do; "any": whatever gets them close.
        staged: most vehicles that come in during an episode where a lawful manoeuvre lacks them; 0: nobody.
        guide: "reward": by the reward model and the attack's own terms; "reward-only": by the reward model alone,
            as in the paper; "none": natural traffic.
        steps: denoising steps of a plan.
        begin: share of the noise schedule at which the denoising begins, see ``diffusion.sampler.Sampling``.
        family: transition of the denoising, see ``diffusion.sampler``.
        eta: share of fresh noise in each denoising step; the family "printed" has 1.
        persistence: how much of a vehicle's starting noise, and so of its intention, is kept from plan to plan.
        temperature: of that noise: 1 draws as the networks were trained, 0 what they hold for likeliest; None: 1 under
            "reckless", as in the paper, else 0.4, with which traffic keeps going and drives more smoothly.
        pace: how much more briskly natural plans are driven than the networks alone would, see ``planning.pace``; 1 is
            about as fast as SUMO's drivers, 0 nothing; None: 0 under "reckless", as in the paper, else 1.
        replan: model steps of 0.5 s of a plan that are driven before the next one (the paper's l).
        samples: joint futures drawn at once, of which the most plausible is driven, in which attackers may run into the
            target.
        weights: a file of weights, or the name of shipped ones; empty: "closed-loop", which drives most like
            people, or, of a reckless one, "traffic", whose decoder is the paper's.
        reward: what ``advdiff-sumo warmup`` has learned of the target: which encounters to go for, or, of a reckless
            one, a reward model in place of the weights'; empty: nothing.
        device: "auto": a GPU where there is one, else the CPU; or a name that PyTorch knows.
    """

    licence: LicenceName = "lawful"
    strength: float = Field(1.0, ge=0.0, le=1.0)
    attackers: int = Field(2, ge=1, le=8)
    attack: Attack = "any"
    staged: int = Field(STAGED, ge=0, le=20)
    guide: Literal["reward", "reward-only", "none"] = "reward"
    steps: int = Field(5, ge=1, le=1000)
    begin: float = Field(0.9, gt=0.0, le=1.0)
    family: Literal["printed", "consistent"] = "consistent"
    eta: float = Field(0.0, ge=0.0, le=1.0)
    persistence: float = Field(0.9, ge=0.0, le=1.0)
    temperature: float | None = Field(None, ge=0.0, le=1.0)
    pace: float | None = Field(None, ge=0.0, le=2.0)
    replan: int = Field(1, ge=1, le=12)
    samples: int = Field(1, ge=1, le=64)
    weights: str = ""
    reward: str = ""
    device: str = "auto"

    @model_validator(mode="after")
    def _attack_fits_licence(self) -> Self:
        reckless = self.licence == "reckless"
        known = RECKLESS_ATTACKS if reckless else tuple(LAWFUL_ATTACKS)
        if self.attack not in known:
            other = "lawful" if reckless else "reckless"
            raise ValueError(
                f"attack = '{self.attack}' is none of licence = '{self.licence}': {', '.join(known)}; "
                f"choose one of them, or licence = '{other}'"
            )
        return self

    @property
    def manoeuvre(self) -> str:
        """The manoeuvre that ``attack`` stands for under a licence."""
        return LAWFUL_ATTACKS[self.attack][0]

    @property
    def attack_term(self) -> str:
        """The guide's term that goes with ``attack``."""
        return self.attack if self.licence == "reckless" else LAWFUL_ATTACKS[self.attack][1]

    @property
    def guided(self) -> bool:
        """Whether anybody is attacked at all."""
        return self.guide != "none" and self.strength > 0.0

    @property
    def noise(self) -> float:
        """Temperature of the noise that a plan begins with."""
        if self.temperature is not None:
            return self.temperature
        return 1.0 if self.licence == "reckless" else 0.4

    @property
    def briskness(self) -> float:
        """Share of the shift of latents with which natural plans are driven."""
        if self.pace is not None:
            return self.pace
        return 0.0 if self.licence == "reckless" else 1.0

    @property
    def q_file(self) -> str:
        """The reward model that replaces the bundle's; "" for none."""
        return "" if self._is_lawful_reward else self.reward

    @property
    def preference(self) -> EncounterPreference | None:
        """Which encounters to go for; None where nothing is known.

        Raises:
            WeightsError: the file cannot be used, or there are no lawful encounters.
        """
        if not self._is_lawful_reward:
            return None
        path = Path(self.reward)
        if self.licence == "reckless":
            raise WeightsError(
                path,
                "says which lawful encounters to go for, and --licence reckless has none",
                "leave --licence out, or give the file of a warm-up with --licence reckless",
            )
        return EncounterPreference.read(path)

    @property
    def _is_lawful_reward(self) -> bool:
        return bool(self.reward) and stored_format(Path(self.reward)) == FORMAT

    @property
    def path(self) -> Path:
        """The networks' file."""
        return find_weights(self.weights, self._shipped)

    @property
    def _shipped(self) -> ShippedName:
        return "traffic" if self.licence == "reckless" else "closed-loop"


class Traj2TrajOptions(DiffusionOptions):
    """Options of ``traj2traj``: those of ``diffusion``, less the guide, for networks that diffuse trajectories."""

    guide: Literal["none"] = "none"
    steps: int = Field(10, ge=1, le=1000)
    temperature: float | None = Field(1.0, ge=0.0, le=1.0)

    @property
    def _shipped(self) -> ShippedName:
        return "traj2traj"
