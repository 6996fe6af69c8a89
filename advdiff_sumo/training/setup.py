"""Prepares a training from options and files."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch

from advdiff_sumo import __version__
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.map_view import MapView
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.core.whole_file import sha256_of
from advdiff_sumo.models.bundle import Bundle, BundleOptions, load_bundle, new_bundle, save_bundle
from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.shipped_weights import WEIGHTS, find_weights
from advdiff_sumo.models.simnet import begin_simnet, save_simnet
from advdiff_sumo.training.checkpoint import TrainingProgress
from advdiff_sumo.training.cvae import TrafficStage
from advdiff_sumo.training.dataset import WindowSet, batches, read_window_set, split
from advdiff_sumo.training.decoder_stage import DecoderStage
from advdiff_sumo.training.denoiser_stage import DenoiserStage, measure_scale
from advdiff_sumo.training.joint_stage import JointStage
from advdiff_sumo.training.presets import STAGES, StageName, TrainOptions
from advdiff_sumo.training.reward_stage import RewardStage
from advdiff_sumo.training.simnet_stage import SimnetStage
from advdiff_sumo.training.stage import BundleStage, Stage
from advdiff_sumo.training.training_loop import TrainingJob

#: Sizes of the networks that a stage replaces in a bundle; they may differ from those of the initial weights.
_NEW_PARTS: Mapping[str, frozenset[str]] = {
    "denoiser": frozenset({"denoiser_layers", "denoiser_situation", "channels"}),
    "situation": frozenset({"denoiser_situation"}),
    "decoder": frozenset({"decoder", "neighbours"}),
}
_NEEDS: Mapping[StageName, tuple[StageName, ...]] = {
    "traffic": (),
    "denoiser": ("traffic",),
    "joint": ("traffic", "denoiser"),
    "reward": ("traffic", "denoiser"),
    "decoder": ("traffic", "denoiser"),
    "simnet": (),
}


@dataclass(frozen=True)
class TrainingRequest:
    """A training as requested by the user.

    Attributes:
        stage: name of the stage.
        data: window files, and folders of window files.
        out: folder of all results.
        options: hyper-parameters.
        init: initial weights, or "shipped"; None: new weights, which only the stages "traffic" and "simnet" allow.
        val: window files for validation; none: some drives of *data* are held out.
        seed: of all random numbers.
        device: "auto", "cpu" or "cuda".
        max_minutes: stop after that time.
        loaders: processes that prepare batches; 0: this process does.
    """

    stage: StageName
    data: tuple[Path, ...]
    out: Path
    options: TrainOptions
    init: Path | None = None
    val: tuple[Path, ...] = ()
    seed: int = 0
    device: str = "auto"
    max_minutes: float = math.inf
    loaders: int = 0
    card: Mapping[str, Any] = field(default_factory=dict)


def prepare(plan: TrainingRequest) -> TrainingJob:
    """Return the training that *plan* describes, with nothing trained or written yet.

    Raises:
        FileError: data or weights cannot be read.
        ConfigError: they do not fit the stage.
    """
    device = choose_device(plan.device)
    if plan.stage == "simnet":
        return _prepared_simnet(plan, device)
    initial = _begun(plan)
    windows = read_window_set(plan.data)
    bundle = _bundle(plan, initial, windows)
    options = plan.options.model_copy(update=_known(bundle.options))
    train, held_out = _sides(plan, windows)
    bundle.to(device)
    if (
        plan.stage == "denoiser" and "denoiser" not in bundle.stages
    ):  # a denoiser trained before keeps its scale
        _measure(bundle, train, options, device)
    stage = _stage(plan.stage, bundle, options, initial)
    if options.compiled and isinstance(bundle.traffic.decoder, ClosedLoopDecoder):
        bundle.traffic.decoder.compile_step()

    def keep(progress: TrainingProgress) -> None:
        save_bundle(bundle, plan.out / WEIGHTS, _stages(bundle, plan.stage), _card(plan, progress))

    return _job(plan, stage, options, windows, (train, held_out), keep, device)


def _prepared_simnet(plan: TrainingRequest, device: torch.device) -> TrainingJob:
    """Return the training of SimNet, which may start from a bundle's encoder, and has a file format of its own."""
    if plan.options.codec is not None:
        raise ConfigError("the stage 'simnet' has no denoiser and so no codec; leave --codec out")
    windows = read_window_set(plan.data)
    seed = SeedTree(plan.seed, ("weights",)).integer()
    init = None if plan.init is None else weights_file(plan.init)
    model = plan.options.model.model_copy(update={"map_view": windows.map_view})
    simnet = begin_simnet(init, model, seed).to(device)
    windows.must_show(simnet.options.map_view)
    options = plan.options.model_copy(update={"model": simnet.options})

    def keep(progress: TrainingProgress) -> None:
        save_simnet(simnet, plan.out / WEIGHTS, _card(plan, progress))

    stage = SimnetStage(simnet, options.simnet)
    return _job(plan, stage, options, windows, _sides(plan, windows), keep, device)


def _job(
    plan: TrainingRequest,
    stage: Stage,
    options: TrainOptions,
    windows: WindowSet,
    sides: tuple[WindowSet, WindowSet],
    keep: Callable[[TrainingProgress], None],
    device: torch.device,
) -> TrainingJob:
    train, held_out = sides
    source = hashlib.sha256(f"{windows.digest}{held_out.digest}{_digest_of(plan.init)}".encode()).hexdigest()
    return TrainingJob(
        stage,
        options,
        train,
        held_out,
        plan.out,
        plan.seed,
        device,
        source,
        keep,
        plan.max_minutes,
        plan.loaders,
    )


def choose_device(name: str) -> torch.device:
    """Return the device *name*; "auto" is CUDA where there is one.

    Raises:
        ConfigError: no such device.
    """
    has_gpu = torch.cuda.is_available()
    if name not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"--device {name}: choose auto, cpu or cuda")
    if name == "cuda" and not has_gpu:
        raise ConfigError("--device cuda: PyTorch sees no CUDA device; choose cpu or auto")
    if has_gpu and name != "cpu":
        torch.set_float32_matmul_precision("high")  # TF32: half the time, errors far below those of a batch
        return torch.device("cuda")
    return torch.device("cpu")


def _begun(plan: TrainingRequest) -> Bundle | None:
    """Return the initial weights; None: new weights.

    Raises:
        ConfigError: the stage needs earlier stages, which have not been trained.
    """
    if plan.init is None:
        if _NEEDS[plan.stage]:
            raise ConfigError(
                f"the stage '{plan.stage}' needs weights of the stage '{_NEEDS[plan.stage][-1]}': name them with --init"
            )
        return None
    initial = load_bundle(weights_file(plan.init))
    missing = [name for name in _NEEDS[plan.stage] if name not in initial.stages]
    if missing:
        raise ConfigError(
            f"{plan.init}: holds {_listed(initial.stages)}, but the stage '{plan.stage}' needs '{missing[0]}'; "
            f"train that first: advdiff-sumo train {missing[0]}"
        )
    return initial


def _bundle(plan: TrainingRequest, initial: Bundle | None, windows: WindowSet) -> Bundle:
    """Return the networks to train: new ones, or the *initial* ones, fitted to the view of *windows*."""
    options, view = plan.options, windows.map_view
    requested = BundleOptions(
        model=options.model.model_copy(update={"map_view": view}),
        codec=options.codec or "latent",
        diffusion_steps=options.diffusion_steps,
        schedule=options.noise_schedule,
    )
    if initial is None:
        return new_bundle(requested, SeedTree(plan.seed, ("weights",)).integer())
    requested = requested.model_copy(update={"codec": options.codec or initial.options.codec})
    return _fitted(plan, initial, requested, windows)


def _known(options: BundleOptions) -> dict[str, Any]:
    """Return the training options that the initial networks determine, with their values."""
    return {
        "model": options.model,
        "codec": options.codec,
        "diffusion_steps": options.diffusion_steps,
        "noise_schedule": options.schedule,
    }


def _fitted(plan: TrainingRequest, initial: Bundle, requested: BundleOptions, windows: WindowSet) -> Bundle:
    """Return *initial*, with a new denoiser if another codec is wanted; refuse impossible combinations."""
    anew = _made_anew(plan, initial, requested)
    new_options = _asked_of_new_parts(plan, initial, anew)
    if anew != "denoiser":
        _must_keep_noise(plan, initial)
    if plan.stage in ("reward", "decoder") and initial.options.codec != "latent":
        raise ConfigError(
            f"{plan.init}: its denoiser works on trajectories, but the stage '{plan.stage}' needs latents"
        )
    if anew == "decoder":
        seed = SeedTree(plan.seed, ("weights",)).integer()
        return with_closed_loop(initial, seed, windows.map_view, new_options)
    windows.must_show(initial.options.model.map_view)
    if plan.stage != "denoiser":
        if initial.options.codec != requested.codec:
            raise ConfigError(
                f"{plan.init}: its denoiser works on the codec '{initial.options.codec}', not '{requested.codec}'"
            )
        return initial
    if anew == "situation":
        return _informed(plan, initial)
    options = requested.model_copy(update={"model": _resized(initial.options.model, new_options)})
    bundle = new_bundle(options, SeedTree(plan.seed, ("weights",)).integer())
    bundle.traffic.load_state_dict(initial.traffic.state_dict())
    bundle.reward.load_state_dict(initial.reward.state_dict())
    return replace(bundle, stages=tuple(name for name in initial.stages if name == "traffic"))


def _made_anew(plan: TrainingRequest, initial: Bundle, requested: BundleOptions) -> str:
    """Return the part of *initial* that the stage replaces: "decoder", "denoiser", only its "situation", or ""."""
    closing = plan.stage == "traffic" and plan.options.model.decoder == "closed-loop"
    if plan.stage == "decoder" or closing:
        return "decoder"
    if plan.stage != "denoiser":
        return ""
    trained = "denoiser" in initial.stages and initial.options.codec == requested.codec
    return "situation" if trained else "denoiser"


def _must_keep_noise(plan: TrainingRequest, initial: Bundle) -> None:
    """Refuse another noise schedule than that of *initial*, whose denoiser is kept.

    Raises:
        ConfigError: another schedule was requested.
    """
    known = _known(initial.options)
    for name in ("diffusion_steps", "noise_schedule"):
        value, has = getattr(plan.options, name), known[name]
        if name in plan.options.model_fields_set and value != has:
            raise ConfigError(
                f"{name} = {value}: the denoiser of {plan.init} has {has}, and the stage '{plan.stage}' makes none "
                "anew; leave it out, or train a denoiser from weights that have none"
            )


def _informed(plan: TrainingRequest, initial: Bundle) -> Bundle:
    """Return *initial* with the requested parts of the denoiser; outputs of new parts are initialised to 0."""
    if initial.options.model.denoiser_situation or not plan.options.model.denoiser_situation:
        return initial
    model = initial.options.model.model_copy(update={"denoiser_situation": True})
    options = initial.options.model_copy(update={"model": model})
    return _grown(initial, options, SeedTree(plan.seed, ("weights",)).integer())


def _asked_of_new_parts(plan: TrainingRequest, initial: Bundle, stage: str) -> dict[str, Any]:
    """Return the requested sizes of the networks that *stage* replaces.

    Raises:
        ConfigError: sizes of other networks were requested that differ from those of *initial*.
    """
    free, model = _NEW_PARTS.get(stage, frozenset()), plan.options.model
    new_options = {name: value for name, value in model if name in model.model_fields_set}
    for name, value in new_options.items():
        has = getattr(initial.options.model, name)
        if name not in free and name != "map_view" and value != has:
            raise ConfigError(
                f"model.{name} = {value}: the networks of {plan.init} have {has}, and the stage '{plan.stage}' makes "
                "none anew to which it applies; leave it out, or train from new weights"
            )
    return {name: value for name, value in new_options.items() if name in free}


def _resized(model: ModelOptions, changed: Mapping[str, Any]) -> ModelOptions:
    """Return *model* with the options *changed*, validated."""
    return ModelOptions.model_validate(model.model_dump() | dict(changed))


def with_closed_loop(
    initial: Bundle,
    seed: int,
    view: MapView | None = None,
    new_options: Mapping[str, Any] = MappingProxyType({}),
) -> Bundle:
    """Return *initial* with a closed-loop decoder, which at first gives the same futures as the decoder before.

    Args:
        initial: networks; not changed.
        seed: of new weights.
        view: view of the map; None: as before.
        new_options: further options of the decoder.
    """
    changed = {**new_options, "decoder": "closed-loop", "map_view": view or initial.options.model.map_view}
    options = initial.options.model_copy(update={"model": _resized(initial.options.model, changed)})
    return _grown(initial, options, seed)


def _grown(initial: Bundle, options: BundleOptions, seed: int) -> Bundle:
    """Return networks of *options* with the weights of *initial*, and those it lacks from *seed*."""
    fresh = new_bundle(options, seed)
    for name, module in fresh.modules().items():
        module.load_state_dict({**module.state_dict(), **initial.modules()[name].state_dict()})
    return replace(fresh, stages=initial.stages)


def weights_file(path: Path) -> Path:
    """Return the weights file of *path*: the name of shipped weights, a file, or the folder of a training."""
    if path.is_dir():
        return path / WEIGHTS
    return find_weights("" if path == Path("shipped") and not path.exists() else str(path))


def _sides(plan: TrainingRequest, windows: WindowSet) -> tuple[WindowSet, WindowSet]:
    if plan.val:
        held_out = read_window_set(plan.val)
        held_out.must_show(windows.map_view, "the windows of --val")
        return windows, held_out
    return split(windows, plan.options.held_out, plan.options.split_seed)


def _measure(bundle: Bundle, windows: WindowSet, options: TrainOptions, device: torch.device) -> None:
    few = windows.subset(windows.spread(options.scale_windows))
    batched = (few.batch(numbers).to(device) for numbers in batches(few, 32))
    measure_scale(bundle, batched, torch.Generator().manual_seed(options.split_seed))


def _stage(name: StageName, bundle: Bundle, options: TrainOptions, initial: Bundle | None) -> BundleStage:
    if name == "traffic":
        return TrafficStage(bundle, options.elbo, options.decoder, options.compiled)
    if name == "denoiser":
        return DenoiserStage(bundle, options.denoiser)
    if name == "joint":
        return JointStage(bundle, options.elbo, options.collision)
    if name == "decoder":
        assert initial is not None  # noqa: S101 - the stage needs earlier ones
        return DecoderStage(bundle, initial.traffic.decoder, options.decoder, options.compiled)
    return RewardStage(bundle, options.reward)


def _stages(bundle: Bundle, name: StageName) -> tuple[str, ...]:
    """Return the completed stages once *name* is trained; later stages no longer fit and are dropped."""
    earlier = STAGES[: STAGES.index(name)]
    return (*(stage for stage in bundle.stages if stage in earlier), name)


def _card(plan: TrainingRequest, progress: TrainingProgress) -> dict[str, Any]:
    return {
        **plan.card,
        "stage": plan.stage,
        "version": __version__,
        "seed": plan.seed,
        "data": progress.data,
        "epoch": progress.epoch,
        "options": progress.options,
        "held_out": progress.history[-1]["held_out"],
    }


def _listed(stages: tuple[str, ...]) -> str:
    return "no trained stage" if not stages else "the stages " + ", ".join(stages)


def _digest_of(weights: Path | None) -> str:
    return "" if weights is None else sha256_of(weights_file(weights))
