"""``advdiff-sumo train``: train one stage of the model."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from advdiff_sumo.cli import train_flags as flags
from advdiff_sumo.cli.evaluate import judge_and_show
from advdiff_sumo.cli.interruption import training_into
from advdiff_sumo.cli.terminal import progress_bar, terminal
from advdiff_sumo.core.errors import FileError, UnknownNameError, os_reason

if TYPE_CHECKING:
    from advdiff_sumo.training.checkpoint import TrainingProgress as State
    from advdiff_sumo.training.presets import StageName, TrainOptions
    from advdiff_sumo.training.training_loop import ProgressListener, TrainingJob


_Init = Annotated[
    Path | None,
    typer.Option(
        help="Weights to begin with: a .safetensors file, the --out of an earlier stage, or shipped."
    ),
]
_Val = Annotated[
    list[Path] | None,
    typer.Option(help="Window files to judge on, instead of some drives of --data.", show_default=False),
]
_Preset = Annotated[
    str | None, typer.Option(help="paper or small: a set of hyper-parameters.", show_default="small")
]
_Codec = Annotated[
    str | None, typer.Option(help="What the denoiser works on: latent or trajectory.", show_default="latent")
]
_Assign = Annotated[
    list[str] | None, typer.Option("--set", help="Any hyper-parameter, as NAME=VALUE: --set batch_size=16.")
]
_MaxMinutes = Annotated[
    float, typer.Option(min=0.0, help="Stop after that time; --resume goes on.", show_default="none")
]
_Loaders = Annotated[
    int, typer.Option(min=0, help="Processes that prepare batches; worth having beside a GPU.")
]
_Judged = Annotated[
    int, typer.Option("--judge", min=0, help="Held-out windows for the table at the end; 0: no table.")
]


def train(
    stage: Annotated[
        str, typer.Argument(help="traffic, denoiser, joint or reward, in this order; decoder; or simnet.")
    ],
    data: flags.Data,
    out: Annotated[Path, typer.Option(help="Folder for weights, checkpoint, curves and metrics.")],
    init: _Init = None,
    val: _Val = None,
    preset: _Preset = None,
    codec: _Codec = None,
    assign: _Assign = None,
    seed: Annotated[int, typer.Option(help="Random seed; the same one gives the same bytes on the CPU.")] = 0,
    device: flags.Device = "auto",
    threads: flags.Threads = None,
    max_minutes: _MaxMinutes = math.inf,
    loaders: _Loaders = 0,
    judged: _Judged = 128,
    resume: flags.Resume = False,
) -> None:
    """Train one stage of the model on window files.

    advdiff-sumo train traffic --data windows --out runs/traffic

    advdiff-sumo train denoiser --data windows --init runs/traffic --out runs/denoiser

    --out gets weights.safetensors (the best on held-out drives), checkpoint.safetensors (for --resume),
    metrics.jsonl, curves.png, evaluation.json and events for TensorBoard. Ctrl-C saves and leaves.
    """
    from advdiff_sumo.training.setup import TrainingRequest, prepare  # late: --help needs no PyTorch

    name = _stage(stage)
    flags.use_threads(threads)
    assignments = [*(assign or []), *([f'codec="{codec}"'] if codec else [])]
    request = TrainingRequest(
        stage=name,
        data=tuple(data),
        out=out,
        options=_options(name, preset, assignments, out if resume else None),
        init=init,
        val=tuple(val or ()),
        seed=seed,
        device=device,
        max_minutes=max_minutes,
        loaders=loaders,
    )
    job = prepare(request)
    claim(out, resume)
    with training_into(out):
        is_finished = _train_with_progress(job, resume, terminal(stderr=True, highlight=False))
    if is_finished and judged and name != "simnet":  # simnet prints its own figures at the end
        _judge(job, judged)


def _judge(job: TrainingJob, windows: int) -> None:
    """Judge the trained weights on at most *windows* held-out windows, and write the table beside the weights."""
    from advdiff_sumo.models.bundle import load_bundle
    from advdiff_sumo.models.shipped_weights import WEIGHTS
    from advdiff_sumo.training.evaluation import EvaluationSettings

    bundle, judging = load_bundle(job.out / WEIGHTS), EvaluationSettings(windows=windows)
    judge_and_show(bundle, job.held_out, judging, job.device, job.out / "evaluation.json")


def _stage(name: str) -> StageName:
    """Return the stage *name*.

    Raises:
        UnknownNameError: there is no such stage.
    """
    from advdiff_sumo.training.presets import STAGES

    for known in STAGES:
        if known == name:
            return known
    raise UnknownNameError("stage", name, STAGES)


def _options(
    name: StageName, preset_name: str | None, assignments: list[str], resumed: Path | None
) -> TrainOptions:
    """Return the given options; if none are given, those of the training in the folder *resumed*."""
    from advdiff_sumo.training import checkpoint
    from advdiff_sumo.training.presets import TrainOptions, preset

    if resumed is not None and preset_name is None and not assignments:
        progress, _ = checkpoint.load(resumed)
        return TrainOptions.parse(progress.options, str(resumed / checkpoint.NAME))
    return preset(preset_name or "small", name, assignments)


def claim(out: Path, resume: bool) -> None:
    """Make the folder *out* for a new training; do nothing if one is resumed.

    Raises:
        FileError: the folder cannot be used or is not empty.
    """
    if resume:
        return
    try:
        out.mkdir(parents=True, exist_ok=True)
        names = sorted(path.name for path in out.iterdir())
    except OSError as error:
        raise FileError(out, f"cannot be used ({os_reason(error)})", "choose another --out") from None
    if names:
        raise FileError(out, f"is not empty ({names[0]})", "choose another --out, or add --resume")


def _train_with_progress(job: TrainingJob, resume: bool, console: Console) -> bool:
    """Train, and print the result; return whether the training is finished."""
    from advdiff_sumo.training import history
    from advdiff_sumo.training.training_loop import Trainer

    with progress_bar(console) as bar:
        trainer = Trainer(job, history.NoEvents(), _progress_callback(bar, job))
        if resume:
            trainer.resume()
        events = history.open_events(job.out / "events", trainer.progress.step)
        if events is None:
            console.print(
                "no TensorBoard events: pip install 'advdiff-sumo[train]' adds them", style="yellow"
            )
        trainer.events = events or history.NoEvents()
        progress = trainer.run()
    _print_result(console, job, progress)
    return progress.done


def _progress_callback(bar: Progress, job: TrainingJob) -> ProgressListener:
    """Return a function that shows the epoch, the loss, the last held-out figure and the remaining time in *bar*."""
    task = bar.add_task(job.stage.name)

    def show(state: State, per_epoch: int, terms: dict[str, float]) -> None:
        held_out = (
            f" · held out {state.history[-1]['held_out'][job.stage.monitor]:.3f}" if state.history else ""
        )
        bar.update(
            task,
            total=per_epoch * job.options.epochs,
            completed=state.step,
            description=f"epoch {state.epoch + 1} · loss {terms['loss']:.3f}{held_out}",
        )

    return show


def _print_result(console: Console, job: TrainingJob, state: State) -> None:
    """Print the figures of the best epoch; if the training was stopped early, how to continue it."""
    if not state.done:
        console.print(
            f"stopped in epoch {state.epoch + 1}; go on with --resume --out {job.out}", soft_wrap=True
        )
        return
    figures = state.history[state.best_epoch - 1]["held_out"]
    text = ", ".join(f"{name} {value:.3f}" for name, value in sorted(figures.items()))
    console.print(
        f"{job.out / 'weights.safetensors'}: best of epoch {state.best_epoch}: {text}", soft_wrap=True
    )
