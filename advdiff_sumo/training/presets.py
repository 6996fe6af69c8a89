"""Every hyper-parameter of every stage, and the two sets of them that have a name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from advdiff_sumo.config import Options, set_dotted
from advdiff_sumo.core.errors import UnknownNameError
from advdiff_sumo.models.codec import CodecName
from advdiff_sumo.models.collate import Jitter
from advdiff_sumo.models.model_options import FUTURE_STEPS, ModelOptions
from advdiff_sumo.training.learning_rates import ScheduleName

StageName = Literal["traffic", "denoiser", "joint", "reward", "decoder", "simnet"]
STAGES: tuple[StageName, ...] = ("traffic", "denoiser", "joint", "reward", "decoder", "simnet")


class ElboOptions(Options):
    """The ELBO (Sec. III-B), per vehicle; its reconstruction is ``models.losses.reconstruction``.

    Attributes:
        kl_weight: weight of the KL divergence of a latent against the mean reconstruction error of a step.
        kl_anneal_share: share of the training over which that weight rises from a hundredth of it.
        free_nats: KL of each of the latent's numbers that costs nothing.
        samples: weight of what is wrong with a draw of the prior, by the terms of :class:`DecoderOptions`; it teaches
            the decoder alone; 0: none.
    """

    kl_weight: float = Field(0.02, ge=0.0)
    kl_anneal_share: float = Field(0.3, ge=0.0, le=1.0)
    free_nats: float = Field(0.0, ge=0.0)
    samples: float = Field(0.0, ge=0.0)


class CollisionOptions(Options):
    """P_coll of the joint stage (Sec. III-B).

    Attributes:
        vehicles: weight of the five-disc overlap between vehicles.
        road: weight of the overlap with the road's edge.
        samples: what counts beside trajectories of the posterior. "denoiser": what the denoiser predicts
            somewhere on its way to a sample, so that it learns to draw scenes that fit together; "decoder": its
            finished samples, for the decoder to keep apart what was drawn apart; "prior": those of the prior;
            or "none".
        sampling_steps: DDIM steps of these samples.
        noise: weight of the noise loss.
        anchor: weight of how far the denoiser's predictions on its way go from those of the denoiser that the
            stage began with; without it the easiest traffic that never collides is traffic that stands.
        traffic: whether encoder, posterior and decoder are trained as well, as in the paper; without them a step
            takes half the time.
    """

    vehicles: float = Field(1.0, ge=0.0)
    road: float = Field(0.5, ge=0.0)
    samples: Literal["denoiser", "decoder", "prior", "none"] = "denoiser"
    sampling_steps: int = Field(5, ge=1, le=1000)
    noise: float = Field(1.0, ge=0.0)
    anchor: float = Field(2.0, ge=0.0)
    traffic: bool = True


class RewardOptions(Options):
    """Pretraining of Q (Sec. III-C).

    Attributes:
        discount: γ a transition.
        execute: model steps l that a transition executes.
        returns: transitions of one plan whose rewards are summed before Q takes over (n-step targets); 1 is
            the paper's target.
        direction: weight of 1 − cos between ∂Q/∂a, which is what guides, and the way that leads to contact, see
            ``training.gradient_alignment``; 0 is the paper's loss.
        look: model steps ahead of which that way is the way.
        push: longest shift up Q, in scaled latents, at which it is taught; guidance goes as far.
        transitions: experiences taken from one window one after another, while its log lasts.
        candidates: latents of the prior over which the maximum of Q is taken.
        target_decay: share of the old target network that a step keeps.
        reach_m: gap at which the reward for being near has fallen to 1/e.
        vehicles: weight of the overlap of background vehicles with each other in the reward.
        road: weight of their overlap with the road's edge.
        prior, noise, diffusion: shares of the sources of the random latents z̃: the prior, N(0, 1), the denoiser.
        sampling_steps: DDIM steps where the denoiser is the source.
    """

    discount: float = Field(0.9, ge=0.0, lt=1.0)
    execute: int = Field(2, ge=1, le=12)
    returns: int = Field(1, ge=1, le=12)
    direction: float = Field(0.3, ge=0.0)
    look: int = Field(6, ge=1, le=12)
    push: float = Field(6.0, ge=0.0)
    transitions: int = Field(2, ge=1, le=12)
    candidates: int = Field(6, ge=1, le=64)
    target_decay: float = Field(0.995, ge=0.0, lt=1.0)
    reach_m: float = Field(5.0, gt=0.0)
    vehicles: float = Field(0.5, ge=0.0)
    road: float = Field(0.2, ge=0.0)
    prior: float = Field(0.4, ge=0.0)
    noise: float = Field(0.1, ge=0.0)
    diffusion: float = Field(0.5, ge=0.0)
    sampling_steps: int = Field(10, ge=1, le=1000)

    @model_validator(mode="after")
    def _fit(self) -> Self:
        """Refuse returns that no window is long enough for."""
        if self.execute * self.returns > FUTURE_STEPS:
            raise ValueError(
                f"execute × returns = {self.execute * self.returns}: the future of a window has {FUTURE_STEPS} steps"
            )
        return self


class SimnetOptions(Options):
    """Closed-loop cloning, see ``training.simnet_stage``.

    Attributes:
        first_steps: model steps that are driven at the beginning of the training.
        steps: and in the end.
        growth_share: share of the training over which they grow.
    """

    first_steps: int = Field(2, ge=1, le=12)
    steps: int = Field(12, ge=1, le=12)
    growth_share: float = Field(0.6, ge=0.0, le=1.0)


class DecoderOptions(Options):
    """The closed-loop decoder's own stage, see ``training.decoder_stage``.

    Attributes:
        vehicles: weight of the overlap between bodies in the model's own samples.
        road: weight of the overlap with the road's edge there.
        anchor: weight of how far a sample strays from what the decoder begun with makes of the same latent, where
            nothing is wrong with that.
        lane: weight of the distance from the nearest lane that points the vehicle's way.
        following: weight of too short a headway and of having to brake too hard.
        progress: weight of the squared relative difference of the way driven from the log's, over a batch.
        sampling_steps: DDIM steps of the samples.
    """

    vehicles: float = Field(0.5, ge=0.0)
    road: float = Field(1.0, ge=0.0)
    anchor: float = Field(0.3, ge=0.0)
    lane: float = Field(0.5, ge=0.0)
    following: float = Field(0.5, ge=0.0)
    progress: float = Field(50.0, ge=0.0)
    sampling_steps: int = Field(5, ge=1, le=1000)


class DenoiserOptions(Options):
    """The denoiser's own stage, see ``training.denoiser_stage``.

    Attributes:
        information: 0: all numbers of a latent count alike, as in the paper; 1: each by the information that the
            posterior puts into it.
        standing: what a vehicle that stands counts against one that drives.
        samples: weight of a proper score of finished samples, so that few steps draw each number as often as the
            posterior does; 0: none.
        sampling_steps: DDIM steps of these samples.
    """

    information: float = Field(0.0, ge=0.0, le=1.0)
    standing: float = Field(1.0, gt=0.0)
    samples: float = Field(0.0, ge=0.0)
    sampling_steps: int = Field(5, ge=1, le=1000)


class TrainOptions(Options):
    """Options of one stage's training.

    Attributes:
        epochs: passes over the training windows.
        epoch_windows: how many of them a pass looks at, drawn anew for each; 0: all.
        driven_share: share of those in which a model drove up to now (``data simulate --driven-by``); 0: as they come.
        batch_size: windows in a step.
        learning_rate: of Adam, at its highest.
        schedule: how it changes, see ``training.learning_rates``.
        precision: of the networks' products; "bfloat16" for GPUs (weights, states and losses stay single precision).
        compiled: let ``torch.compile`` fuse what a closed-loop decoder does at each step; for GPUs.
        gradient_clip: largest norm of the gradient.
        ema_decay: of the moving average of the weights.
        patience_epochs: epochs without progress on held-out windows after which it stops; 0: never.
        max_agents: agents of a window that are looked at in training, those nearest to its focal one.
        held_out: about what share of the drives is held out.
        split_seed: which ones; the same in all stages, whatever their seed.
        held_out_windows: most windows that an epoch's evaluation looks at.
        checkpoint_minutes: time between two checkpoints within an epoch.
        codec: space in which the diffusion works: "latent", or "trajectory", the paper's ablation traj2traj;
            None: that of the weights begun with, latent for new ones.
        diffusion_steps: K of the noise schedule, where the denoiser is new.
        noise_schedule: its kind.
        scale_windows: windows over which the diffused numbers are standardised.
        model: sizes of the networks, where they are new.
    """

    epochs: int = Field(200, ge=1)
    epoch_windows: int = Field(0, ge=0)
    driven_share: float = Field(0.0, ge=0.0, le=1.0)
    batch_size: int = Field(8, ge=1)
    learning_rate: float = Field(5e-4, gt=0.0)
    schedule: ScheduleName = "constant"
    precision: Literal["float32", "bfloat16"] = "float32"
    compiled: bool = False
    gradient_clip: float = Field(5.0, gt=0.0)
    ema_decay: float = Field(0.999, ge=0.0, lt=1.0)
    patience_epochs: int = Field(20, ge=0)
    max_agents: int = Field(24, ge=2)
    held_out: float = Field(0.1, gt=0.0, lt=1.0)
    split_seed: int = Field(0, ge=0)
    held_out_windows: int = Field(1024, ge=1)
    checkpoint_minutes: float = Field(5.0, ge=0.0)
    codec: CodecName | None = None
    diffusion_steps: int = Field(100, ge=1, le=10_000)
    noise_schedule: Literal["cosine", "linear"] = "cosine"
    scale_windows: int = Field(2048, ge=1)
    model: ModelOptions = ModelOptions()
    jitter: Jitter = Jitter()
    elbo: ElboOptions = ElboOptions()
    collision: CollisionOptions = CollisionOptions()
    reward: RewardOptions = RewardOptions()
    denoiser: DenoiserOptions = DenoiserOptions()
    decoder: DecoderOptions = DecoderOptions()
    simnet: SimnetOptions = SimnetOptions()


_SMALL: dict[str, Any] = {
    "batch_size": 32,
    "learning_rate": 1e-3,
    "schedule": "one-cycle",
    "patience_epochs": 0,
    "held_out_windows": 512,
    "ema_decay": 0.998,
    "max_agents": 16,
}
_EPOCHS: Mapping[StageName, int] = {
    "traffic": 12,
    "denoiser": 20,
    "joint": 4,
    "reward": 6,
    "decoder": 6,
    "simnet": 6,
}
_PAPER: dict[str, Any] = {"epochs": 200, "batch_size": 8, "learning_rate": 5e-4, "schedule": "constant"}
_PAPER_REWARD: dict[str, Any] = {"epochs": 100, "learning_rate": 1e-3}
PRESETS = ("paper", "small")


def preset(name: str, stage: StageName, assignments: Iterable[str] = ()) -> TrainOptions:
    """Return the options of a preset.

    Args:
        name: "paper" (Sec. IV, Implementation Details) or "small" (two CPU cores, about an hour in all).
        stage: the stage that they are for.
        assignments: changes, each as NAME=VALUE with dots between the levels.

    Raises:
        UnknownNameError: there is no such preset.
        ConfigError: an assignment names no option, or its value is out of bounds.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    values: dict[str, Any] = _paper(stage) if name == "paper" else _small(stage)
    for assignment in assignments:
        set_dotted(values, assignment)
    return TrainOptions.parse(values, "--set")


def _paper(stage: StageName) -> dict[str, Any]:
    if stage == "reward":
        return {**_PAPER, **_PAPER_REWARD, "reward": {"direction": 0.0}}
    return dict(_PAPER)


def _small(stage: StageName) -> dict[str, Any]:
    values = {**_SMALL, "epochs": _EPOCHS[stage]}
    if stage == "joint":
        values |= {"learning_rate": 2e-4, "elbo": {"kl_anneal_share": 0.0}}
    if stage == "reward":
        values |= {"reward": {"returns": 3}}
    if stage == "decoder":
        values |= {"batch_size": 16, "learning_rate": 7e-4, "ema_decay": 0.995, "held_out_windows": 128}
    return values
