"""Options of ``diffusion`` and ``traj2traj``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal, Self, TypeAlias

from pydantic import Field, model_validator

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.failure_predictor import FORMAT
from advdiff_sumo.models.shipped_weights import ShippedName, find_weights
from advdiff_sumo.models.stored import stored_format
from advdiff_sumo.traffic.attack_names import RECKLESS_ATTACKS, FurtherAttack
from advdiff_sumo.traffic.licence import LicenceName
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference
from advdiff_sumo.traffic.manoeuvres.intensity import SeverityOptions
from advdiff_sumo.traffic.manoeuvres.staging import DEFAULT_MAX_INSERTED

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
    "close-pass": ("close-pass", "any"),
    "blind-spot": ("blind-spot", "any"),
    "short-gaps": ("short-gaps", "junction"),
}
"""Attack → its manoeuvre under a licence, and the cost term of the guide."""


class DiffusionOptions(SeverityOptions):
    """Options of ``diffusion``, beside those that prescribe the severity of its lawful manoeuvres.

    Attributes:
        licence: what attackers may do: "lawful": break no traffic rule; lawful manoeuvres are driven beside the guided
            plans; "careless": the same with smaller gaps; "reckless": anything that moves like a vehicle, as in the
            paper.
        strength: how hard attackers are guided against the target; 0: exactly natural traffic.
        attackers: largest number of simultaneously guided vehicles, and of lawful manoeuvres beside them.
        attack: kind of attack; "any": whatever brings attackers near the target.
        staged: largest number of vehicles inserted during an episode where a lawful manoeuvre needs them; 0: none.
        guide: "reward": the reward model and the cost terms of the attack; "reward-only": the reward model alone, as
            in the paper; "none": natural traffic.
        steps: denoising steps of a plan.
        begin: share of the noise schedule at which denoising begins; see ``diffusion.sampler.Sampling``.
        family: transition of a denoising step; see ``diffusion.sampler``.
        eta: share of fresh noise in each denoising step; the family "printed" has 1.
        persistence: share of a vehicle's starting noise, and so of its intention, that is kept from plan to plan.
        temperature: factor on that noise: 1: as in training; 0: the most likely plan; None: 1 under "reckless", as in
            the paper, else 0.4, with which traffic keeps moving and drives more smoothly.
        pace: how much faster natural plans are than those of the networks alone; see ``planning.pace``. 1: about as
            fast as SUMO's drivers; 0: no faster; None: 0 under "reckless", as in the paper, else 1.
        replan: number of model steps of 0.5 s of a plan that are driven before the next plan (the paper's l).
        samples: number of joint futures drawn at once. The most plausible one is driven; collisions of attackers with
            the target do not count against it.
        weights: a file of weights, or the name of shipped ones; empty: "closed-loop", which drives most like people,
            or under "reckless" "traffic", whose decoder is the paper's.
        reward: result of ``advdiff-sumo warmup``: preferred encounters, or under "reckless" a reward model that
            replaces that of the weights; empty: none.
        device: "auto": a GPU if there is one, else the CPU; or a device name of PyTorch.
    """

    licence: LicenceName = "lawful"
    strength: float = Field(1.0, ge=0.0, le=1.0)
    attackers: int = Field(2, ge=1, le=8)
    attack: Attack = "any"
    staged: int = Field(DEFAULT_MAX_INSERTED, ge=0, le=20)
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
        prescribed = [name for name in SeverityOptions.model_fields if getattr(self, name) is not None]
        if reckless and prescribed:
            raise ValueError(f"{prescribed[0]}: a reckless attack has no prescribed severity; leave it out")
        return self

    @property
    def manoeuvre(self) -> str:
        """The manoeuvre of ``attack`` under a licence."""
        return LAWFUL_ATTACKS[self.attack][0]

    @property
    def attack_term(self) -> str:
        """The cost term of the guide for ``attack``."""
        return self.attack if self.licence == "reckless" else LAWFUL_ATTACKS[self.attack][1]

    @property
    def guided(self) -> bool:
        """Whether the policy attacks the target at all."""
        return self.guide != "none" and self.strength > 0.0

    @property
    def noise(self) -> float:
        """Factor on the starting noise of a plan."""
        if self.temperature is not None:
            return self.temperature
        return 1.0 if self.licence == "reckless" else 0.4

    @property
    def briskness(self) -> float:
        """Share of the shift of latents that makes natural plans faster."""
        if self.pace is not None:
            return self.pace
        return 0.0 if self.licence == "reckless" else 1.0

    @property
    def q_file(self) -> str:
        """The file of a reward model that replaces the bundle's; "": none."""
        return "" if self._is_lawful_reward else self.reward

    @property
    def preference(self) -> EncounterPreference | None:
        """The preferred encounters; None without a preference.

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
        """The file of the networks."""
        return find_weights(self.weights, self._shipped)

    @property
    def _shipped(self) -> ShippedName:
        return "traffic" if self.licence == "reckless" else "closed-loop"


class Traj2TrajOptions(DiffusionOptions):
    """Options of ``traj2traj``: those of ``diffusion`` without the guide, for networks that diffuse trajectories."""

    guide: Literal["none"] = "none"
    steps: int = Field(10, ge=1, le=1000)
    temperature: float | None = Field(1.0, ge=0.0, le=1.0)

    @property
    def _shipped(self) -> ShippedName:
        return "traj2traj"
