"""``advdiff-sumo train``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from advdiff_sumo.cli.evaluate import judge_and_show
from advdiff_sumo.cli.terminal import progress_bar
from advdiff_sumo.core.errors import FileError, UnknownNameError

if TYPE_CHECKING:
    from advdiff_sumo.training.checkpoint import Progress as State
    from advdiff_sumo.training.presets import StageName, TrainOptions
    from advdiff_sumo.training.training_loop import Job, Tell


def train(
    stage: Annotated[
        str, typer.Argument(help="traffic, denoiser, joint or reward, in this order; decoder; or simnet.")
    ],
    data: Annotated[
        list[Path], typer.Option(help="Window file, or a folder of them; may be given several times.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for weights, checkpoint, curves and metrics.")],
    init: Annotated[
        Path | None,
        typer.Option(
            help="Weights to begin with: a .safetensors file, the --out of an earlier stage, or shipped."
        ),
    ] = None,
    val: Annotated[
        list[Path] | None,
        typer.Option(help="Window files to judge on, instead of some drives of --data.", show_default=False),
    ] = None,
    preset: Annotated[
        str | None, typer.Option(help="paper or small: a set of hyper-parameters.", show_default="small")
    ] = None,
    codec: Annotated[
        str | None,
        typer.Option(help="What the denoiser works on: latent or trajectory.", show_default="latent"),
    ] = None,
    assign: Annotated[
        list[str] | None,
        typer.Option("--set", help="Any hyper-parameter, as NAME=VALUE: --set batch_size=16."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Same seed, same bytes (on the CPU).")] = 0,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    threads: Annotated[int | None, typer.Option(min=1, help="CPU threads.", show_default="all")] = None,
    max_minutes: Annotated[
        float, typer.Option(min=0.0, help="Stop after that time; --resume goes on.", show_default="none")
    ] = math.inf,
    loaders: Annotated[
        int, typer.Option(min=0, help="Processes that prepare batches; worth having beside a GPU.")
    ] = 0,
    judged: Annotated[
        int, typer.Option("--judge", min=0, help="Held-out windows for the table at the end; 0: no table.")
    ] = 128,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the training in --out.")] = False,
) -> None:
    """Train one stage of the model on window files.

    advdiff-sumo train traffic --data windows --out runs/traffic

    advdiff-sumo train denoiser --data windows --init runs/traffic --out runs/denoiser

    --out gets weights.safetensors (the best on held-out drives), checkpoint.safetensors (for --resume),
    metrics.jsonl, curves.png, evaluation.json and events for TensorBoard. Ctrl-C saves and leaves.
    """
    import torch  # late: --help needs no PyTorch

    from advdiff_sumo.models.bundle import load_bundle
    from advdiff_sumo.training.evaluation import Judging
    from advdiff_sumo.training.setup import WEIGHTS, Plan, prepare

    name = _stage(stage)
    if threads is not None:
        torch.set_num_threads(threads)
    assignments = [*(assign or []), *([f'codec="{codec}"'] if codec else [])]
    plan = Plan(
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
    job = prepare(plan)
    claim(out, resume)
    done = _train(job, resume, Console(stderr=True, highlight=False))
    if done and judged and name != "simnet":  # its own figures are said when it ends
        bundle = load_bundle(out / WEIGHTS)
        judge_and_show(bundle, job.held_out, Judging(windows=judged), job.device, out / "evaluation.json")


def _stage(asked: str) -> StageName:
    """Return the stage that the user asked for.

    Raises:
        UnknownNameError: there is none of that name.
    """
    from advdiff_sumo.training.presets import STAGES

    for known in STAGES:
        if known == asked:
            return known
    raise UnknownNameError("stage", asked, STAGES)


def _options(
    name: StageName, preset_name: str | None, assignments: list[str], begun: Path | None
) -> TrainOptions:
    """Return the options given, or those of the training *begun* where none are given."""
    from advdiff_sumo.training import checkpoint
    from advdiff_sumo.training.presets import TrainOptions, preset

    if begun is not None and preset_name is None and not assignments:
        progress, _ = checkpoint.load(begun)
        return TrainOptions.parse(progress.options, str(begun / checkpoint.NAME))
    return preset(preset_name or "small", name, assignments)


def claim(out: Path, resume: bool) -> None:
    """Make the folder; refuse one that holds anything, unless that is a training to go on with."""
    if resume:
        return
    try:
        out.mkdir(parents=True, exist_ok=True)
        held = sorted(path.name for path in out.iterdir())
    except OSError as error:
        raise FileError(out, f"cannot be used ({error.strerror})", "choose another --out") from None
    if held:
        raise FileError(out, f"is not empty ({held[0]})", "choose another --out, or add --resume")


def _train(job: Job, resume: bool, console: Console) -> bool:
    """Train and say how it ended; return whether it has."""
    from advdiff_sumo.training import history
    from advdiff_sumo.training.training_loop import Trainer

    events = history.open_events(job.out / "events", 0)
    if events is None:
        console.print(
            "no TensorBoard events: pip install 'advdiff-sumo[train]' adds them", style="yellow", markup=False
        )
    with progress_bar(console) as bar:
        trainer = Trainer(job, events or history.NoEvents(), _teller(bar, job))
        if resume:
            trainer.resume()
        progress = trainer.run()
    _say(console, job, progress)
    return progress.done


def _teller(bar: Progress, job: Job) -> Tell:
    """Return what shows the progress: epochs, the loss, the last held-out figure, time left."""
    task = bar.add_task(job.stage.name)

    def tell(state: State, per_epoch: int, terms: dict[str, float]) -> None:
        held = f" · held out {state.history[-1]['held_out'][job.stage.monitor]:.3f}" if state.history else ""
        bar.update(
            task,
            total=per_epoch * job.options.epochs,
            completed=state.step,
            description=f"epoch {state.epoch + 1} · loss {terms['loss']:.3f}{held}",
        )

    return tell


def _say(console: Console, job: Job, state: State) -> None:
    if not state.done:
        console.print(f"stopped in epoch {state.epoch + 1}; go on with --resume --out {job.out}")
        return
    figures = state.history[state.best_epoch - 1]["held_out"]
    shown = ", ".join(f"{name} {value:.3f}" for name, value in sorted(figures.items()))
    console.print(f"{job.out / 'weights.safetensors'}: best of epoch {state.best_epoch}: {shown}")
