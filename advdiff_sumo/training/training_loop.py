"""The training loop, the same for every stage; a resumed training gives the same bytes.

Order, noise and augmentation of a step depend only on the seed and the number of the step, so that checkpoints need no
state of random generators.
"""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from advdiff_sumo.core.errors import ConfigError, TrainingError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.collate import Jitter
from advdiff_sumo.training import checkpoint, history
from advdiff_sumo.training.checkpoint import TrainingProgress
from advdiff_sumo.training.dataset import IntArray, WindowSet, batches, nearest, of_epoch, padded
from advdiff_sumo.training.ema import Ema
from advdiff_sumo.training.interrupt import StopRequest, graceful
from advdiff_sumo.training.learning_rates import rate_factor
from advdiff_sumo.training.presets import TrainOptions
from advdiff_sumo.training.stage import Moment, Stage, Tally, add, means

_REDRAW_S = 30.0

ProgressListener = Callable[[TrainingProgress, int, dict[str, float]], None]
"""Called after each step with progress, number of batches in the epoch, and means of the loss terms so far."""


@dataclass(frozen=True)
class TrainingJob:
    """All inputs of a training.

    Attributes:
        stage: the stage.
        options: its hyper-parameters.
        train: training windows.
        held_out: validation windows.
        out: folder of all results.
        seed: of order, noise and augmentation.
        device: of the tensors.
        source: hash of the data and of the initial weights, kept in checkpoints.
        keep: writes the stage's weights; called when they are the best so far.
        max_minutes: stop after that time, to be resumed later; infinite: never.
        loaders: processes that prepare batches; 0: this process does.
    """

    stage: Stage
    options: TrainOptions
    train: WindowSet
    held_out: WindowSet
    out: Path
    seed: int
    device: torch.device
    source: str
    keep: Callable[[TrainingProgress], None]
    max_minutes: float = math.inf
    loaders: int = 0


@dataclass(frozen=True)
class _Steps(Dataset[SceneBatch]):
    """The batches of the steps from *first* on."""

    windows: WindowSet
    options: TrainOptions
    tree: SeedTree
    order: tuple[IntArray, ...]
    first: int

    def __len__(self) -> int:
        return len(self.order)

    def __getitem__(self, number: int) -> SceneBatch:
        rng = self.tree.child("jitter", self.first + number).generator()
        batch = self.windows.batch(self.order[number], rng, _jitter(self.options))
        batch = nearest(batch, self.options.max_agents)
        return padded(batch, self.options.max_agents) if self.options.compiled else batch


def _alone(_: int) -> None:
    """Set up a process that prepares batches: one thread, and Ctrl-C is left to the training."""
    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class Trainer:
    """A training that can be interrupted and resumed.

    Args:
        job: inputs of the training.
        events: TensorBoard writer.
        on_progress: called after each step.
    """

    def __init__(self, job: TrainingJob, events: history.Events, on_progress: ProgressListener) -> None:
        self.job, self.events, self.on_progress = job, events, on_progress
        self.tree = SeedTree(job.seed, ("training", job.stage.name))
        options = job.options
        parameters = [p for p in job.stage.module.parameters() if p.requires_grad]
        self.parameters = parameters
        self.optimiser = torch.optim.Adam(
            parameters, lr=options.learning_rate, fused=job.device.type == "cuda" or None
        )
        self.ema = Ema(job.stage.module, options.ema_decay)
        self.progress = TrainingProgress(
            job.stage.name, options.model_dump(mode="json"), job.source, job.seed
        )
        self._drawn = time.monotonic()
        whole = (options.epoch_windows or len(job.train)) / options.batch_size
        self.per_epoch = math.floor(whole) if options.compiled else math.ceil(whole)
        if not self.per_epoch:
            count = options.epoch_windows or len(job.train)
            raise ConfigError(
                f"an epoch has {count} windows, fewer than batch_size = {options.batch_size}, and compiled trainings "
                "have whole batches alone; lower batch_size, or leave compiled out"
            )
        self.total = self.per_epoch * options.epochs

    def resume(self) -> None:
        """Resume the training in the job's folder.

        Raises:
            FileError: there is no checkpoint, or it is damaged.
            ConfigError: it is of another stage, other options or other data.
        """
        progress, groups = checkpoint.load(self.job.out)
        _same(self.job.out, progress, self.progress)
        self.job.stage.module.load_state_dict(groups.get("model", {}))
        self.job.stage.beside.load_state_dict(groups.get("beside", {}))
        self.ema.load(groups["ema"])
        checkpoint.restore_optimiser(self.optimiser, groups.get("optimiser", {}))
        self.progress = progress

    def run(self) -> TrainingProgress:
        """Train to the end, or until there is no more progress, the time is up, or the user stops it.

        Returns:
            Progress of the training; ``done`` tells whether it has ended.

        Raises:
            TrainingError: a loss or gradient is not a number.
            KeyboardInterrupt: the user stopped it; everything is saved.
        """
        start_s = time.monotonic()
        try:
            with graceful() as wish:
                self._epochs(start_s, wish)
        finally:
            self._draw(0.0)
            self.events.close()
        if wish:
            raise KeyboardInterrupt
        return self.progress

    def _epochs(self, start_s: float, wish: StopRequest) -> None:
        progress = self.progress
        while not progress.done:
            if not self._epoch(start_s, wish):
                self.save()
                return
            self._judge()
            progress.done = progress.epoch >= self.job.options.epochs or self._stuck()
            self.save()

    def _epoch(self, start_s: float, wish: StopRequest) -> bool:
        """Train the rest of the epoch; return False if stopped before its end."""
        progress, saved = self.progress, time.monotonic()
        limit_s, between_s = 60.0 * self.job.max_minutes, 60.0 * self.job.options.checkpoint_minutes
        order = self._order()
        for batch in self._batches(order[progress.batch :]):
            if wish or time.monotonic() - start_s > limit_s:
                return False
            self._step(batch.to(self.job.device))
            if time.monotonic() - saved > between_s:
                self.save()
                saved = time.monotonic()
            self.on_progress(progress, len(order), means(progress.sums))
        return True

    def _order(self) -> list[IntArray]:
        rng, options = self.tree.child("order", self.progress.epoch).generator(), self.job.options
        numbers = of_epoch(self.job.train, options.epoch_windows, options.driven_share, rng)
        cut = batches(self.job.train.subset(numbers), options.batch_size, rng)
        order = [numbers[batch] for batch in cut]
        if not options.compiled:
            return order
        return [batch for batch in order if len(batch) == options.batch_size]  # all of the same shape

    def _batches(self, order: list[IntArray]) -> Iterator[SceneBatch]:
        """Yield the remaining batches of the epoch, on the CPU; their contents depend only on the step."""
        job, first = self.job, self.progress.step
        steps = _Steps(job.train, job.options, self.tree, tuple(order), first)
        if not job.loaders:
            return (steps[number] for number in range(len(order)))
        return iter(
            DataLoader(
                steps, batch_size=None, num_workers=job.loaders, prefetch_factor=4, worker_init_fn=_alone
            )
        )

    def _step(self, batch: SceneBatch) -> None:
        progress, options, stage = self.progress, self.job.options, self.job.stage
        moment = self._moment(progress.step)
        for group in self.optimiser.param_groups:
            group["lr"] = options.learning_rate * rate_factor(options.schedule, progress.step, self.total)
        stage.module.train()
        with torch.autocast(self.job.device.type, torch.bfloat16, options.precision == "bfloat16"):
            terms = stage.loss(batch, moment)
        self.optimiser.zero_grad(set_to_none=True)
        _finite(terms, progress)
        torch.autograd.backward(terms["loss"])
        norm = torch.nn.utils.clip_grad_norm_(self.parameters, options.gradient_clip)
        _finite({"gradient": norm}, progress)
        self.optimiser.step()
        self.ema.update(progress.step)
        stage.after_step()
        self._note(terms, batch.scenes)

    def _note(self, terms: dict[str, Tensor], windows: int) -> None:
        progress = self.progress
        values = {name: float(value.detach()) for name, value in terms.items()}
        add(progress.sums, {name: (value * windows, windows) for name, value in values.items()})
        progress.step += 1
        progress.batch += 1
        if progress.step % 20 == 0:
            for name, value in values.items():
                self.events.add_scalar(f"step/{name}", value, progress.step)

    def _moment(self, step: int) -> Moment:
        generator = torch.Generator().manual_seed(self.tree.child("noise", step).integer(62))
        return Moment(step, self.total, generator)

    def _judge(self) -> None:
        """Evaluate the averaged weights, write records and curves, and keep the weights if they are the best."""
        progress, stage = self.progress, self.job.stage
        with self.ema.applied():
            held_out = means(evaluate(stage, self.job.held_out, self.job.options, self.job.device))
            progress.epoch, progress.batch = progress.epoch + 1, 0
            record = {"epoch": progress.epoch, "step": progress.step, "held_out": held_out}
            progress.history.append({**record, "train": means(progress.sums)})
            progress.sums = {}
            figure = held_out[stage.monitor]
            if progress.best is None or figure < progress.best:
                progress.best, progress.best_epoch = figure, progress.epoch
                self.job.keep(progress)
        history.write_lines(self.job.out / "metrics.jsonl", progress.history)
        self._draw(_REDRAW_S)
        history.write_events(self.events, progress.history[-1])

    def _draw(self, age_s: float) -> None:
        """Draw the curves, unless they were drawn less than *age_s* ago: this takes longer than some epochs."""
        if self.progress.history and time.monotonic() - self._drawn > age_s:
            history.draw_curves(self.job.out / "curves.png", self.job.stage.name, self.progress.history)
            self._drawn = time.monotonic()

    def _stuck(self) -> bool:
        patience = self.job.options.patience_epochs
        return patience > 0 and self.progress.epoch - self.progress.best_epoch >= patience

    def save(self) -> None:
        """Write the checkpoint.

        Raises:
            FileError: it cannot be written.
        """
        groups = {
            "model": self.job.stage.module.state_dict(),
            "ema": self.ema.shadow,
            "optimiser": checkpoint.optimiser_tensors(self.optimiser),
            "beside": self.job.stage.beside.state_dict(),
        }
        checkpoint.save(self.job.out, self.progress, groups)


@torch.no_grad()
def evaluate(stage: Stage, windows: WindowSet, options: TrainOptions, device: torch.device) -> Tally:
    """Evaluate *stage* on held-out windows, always on the same ones with the same noise."""
    stage.module.eval()
    total: Tally = {}
    for number, numbers in enumerate(held_out_batches(windows, options)):
        generator = torch.Generator().manual_seed(
            SeedTree(options.split_seed, ("judge", str(number))).integer(62)
        )
        add(total, stage.evaluate(windows.batch(numbers).to(device), generator))
    return total


def held_out_batches(windows: WindowSet, options: TrainOptions) -> Iterator[IntArray]:
    """Yield batches of the held-out windows of an evaluation: evenly spaced, at most ``held_out_windows``."""
    chosen = windows.spread(options.held_out_windows)
    for numbers in batches(windows.subset(chosen), max(options.batch_size, 16)):
        yield chosen[numbers]


def _jitter(options: TrainOptions) -> Jitter | None:
    return options.jitter if options.jitter.share > 0.0 or options.jitter.mirror > 0.0 else None


def _finite(terms: dict[str, Tensor], progress: TrainingProgress) -> None:
    for name, value in terms.items():
        if not math.isfinite(float(value.detach())):
            raise TrainingError(
                f"step {progress.step} of epoch {progress.epoch + 1}: '{name}' is {float(value.detach())}; begin "
                "again in a new --out with a lower --set learning_rate, or look at the data"
            )


def _same(folder: Path, old: TrainingProgress, new: TrainingProgress) -> None:
    """Refuse to resume with another stage, other options or other data."""
    if old.stage != new.stage:
        raise ConfigError(f"{folder} holds a training of the stage '{old.stage}', not of '{new.stage}'")
    for name, value in new.options.items():
        if old.options.get(name) != value:
            raise ConfigError(
                f"{folder} was begun with {name} = {old.options.get(name)}, not {value}; leave it out, or choose "
                "another --out"
            )
    if old.seed not in (None, new.seed):
        raise ConfigError(
            f"{folder} was begun with --seed {old.seed}, not {new.seed}; give that one, or choose another --out"
        )
    if old.data != new.data:
        raise ConfigError(f"{folder} was begun with other data or other --init weights; choose another --out")
