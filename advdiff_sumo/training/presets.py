"""Hyper-parameters of all stages, and their two presets."""

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
        kl_weight: weight of the KL divergence of a latent, relative to the mean reconstruction error of a step.
        kl_anneal_share: share of the training in which that weight rises from a hundredth of it.
        free_nats: KL of each dimension of the latent that is not penalised.
        samples: weight of the penalties of samples of the prior, see :class:`DecoderOptions`, which train only the
            decoder; 0: none.
    """

    kl_weight: float = Field(0.02, ge=0.0)
    kl_anneal_share: float = Field(0.3, ge=0.0, le=1.0)
    free_nats: float = Field(0.0, ge=0.0)
    samples: float = Field(0.0, ge=0.0)


class CollisionOptions(Options):
    """P_coll of the joint stage (Sec. III-B).

    Attributes:
        vehicles: weight of the five-disc overlap between vehicles.
        road: weight of the overlap with the road edge.
        samples: what is penalised besides futures of the posterior. "denoiser": the denoiser's predictions at random
            steps, so that it learns to sample scenes without overlap; "decoder": its finished samples, which train
            the decoder; "prior": samples of the prior;
            "none".
        sampling_steps: DDIM steps of these samples.
        noise: weight of the noise loss.
        anchor: weight of the squared difference of the denoiser's predictions from those of the stage's initial
            denoiser; without it the penalties are minimised by traffic that stands still.
        traffic: whether encoder, posterior and decoder are trained, too, as in the paper; without them a step takes
            half the time.
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
        discount: γ of one transition.
        execute: model steps l of one transition.
        returns: transitions of one plan whose rewards are summed before Q(s', ·) (n-step targets); 1: the paper's
            target.
        direction: weight of 1 − cos between ∂Q/∂a and the direction that leads to contact, see
            ``training.gradient_alignment``; 0: the paper's loss.
        look: horizon of that direction, in model steps.
        push: longest shift along Q's gradient, in scaled latents, at which the direction is trained; as in guidance.
        transitions: successive experiences of one window, as far as its log goes.
        candidates: samples of the prior over which the maximum of Q is taken.
        target_decay: factor of the old target network in each step.
        reach_m: gap at which the reward for proximity has fallen to 1/e.
        vehicles: weight of the overlap between background vehicles in the reward.
        road: weight of their overlap with the road edge.
        prior, noise, diffusion: shares of the sources of the random latents z̃: prior, N(0, 1), denoiser.
        sampling_steps: DDIM steps of the source denoiser.
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
        """Refuse returns that are longer than a window."""
        if self.execute * self.returns > FUTURE_STEPS:
            raise ValueError(
                f"execute × returns = {self.execute * self.returns}: the future of a window has {FUTURE_STEPS} steps"
            )
        return self


class SimnetOptions(Options):
    """Closed-loop behaviour cloning, see ``training.simnet_stage``.

    Attributes:
        first_steps: model steps of a rollout at the beginning of the training.
        steps: model steps of a rollout at the end of the training.
        growth_share: share of the training in which the number of steps grows.
    """

    first_steps: int = Field(2, ge=1, le=12)
    steps: int = Field(12, ge=1, le=12)
    growth_share: float = Field(0.6, ge=0.0, le=1.0)


class DecoderOptions(Options):
    """The stage of the closed-loop decoder, see ``training.decoder_stage``; weights are of the model's own samples.

    Attributes:
        vehicles: weight of the overlap between vehicles.
        road: weight of the overlap with the road edge.
        anchor: weight of the difference from the initial decoder's future for the same latent, where that has no
            penalty.
        lane: weight of the lateral distance from the nearest lane in the vehicle's direction.
        following: weight of too short a headway and too high a required deceleration.
        progress: weight of the squared relative difference between driven distance and the log's, over a batch.
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
    """The stage of the denoiser, see ``training.denoiser_stage``.

    Attributes:
        information: 0: all dimensions of a latent have the same weight, as in the paper; 1: each is weighted by its
            information in the posterior.
        standing: weight of a standing vehicle, relative to a driving one.
        samples: weight of a proper score of finished samples, which trains sampling in few steps to match the
            posterior's distribution; 0: none.
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
        epoch_windows: windows of one epoch, drawn anew for each; 0: all.
        driven_share: share of windows with a past driven by a model (``data simulate --driven-by``); 0: as in the data.
        batch_size: windows in a step.
        learning_rate: of Adam, its maximum.
        schedule: of the learning rate, see ``training.learning_rates``.
        precision: of matrix products; "bfloat16" for GPUs (weights, states and losses stay in single precision).
        compiled: whether to use ``torch.compile`` for the steps of a closed-loop decoder; for GPUs.
        gradient_clip: largest norm of the gradient.
        ema_decay: of the moving average of the weights.
        patience_epochs: epochs without progress on held-out windows after which training stops; 0: never.
        max_agents: agents of a window used in training, those nearest to its focal one.
        held_out: approximate share of the drives that is held out.
        split_seed: of the choice of held-out drives; independent of the training's seed, so that all stages agree.
        held_out_windows: most windows of an epoch's evaluation.
        checkpoint_minutes: time between checkpoints within an epoch.
        codec: what is diffused: "latent", or "trajectory", the paper's ablation traj2traj; None: that of the initial
            weights, latent for new ones.
        diffusion_steps: K of the noise schedule of a new denoiser.
        noise_schedule: kind of the noise schedule of a new denoiser.
        scale_windows: windows from which the scale of the diffused numbers is computed.
        model: sizes of new networks.
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
