"""``advdiff-sumo evaluate``: judge weights on window files; also prints the table at the end of ``train``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE
from rich.table import Table

from advdiff_sumo.cli import train_flags as flags
from advdiff_sumo.cli.terminal import progress_bar, terminal
from advdiff_sumo.core.whole_file import check_writable

_HEADS = {
    "ade_m": "ADE",
    "fde_m": "FDE",
    "min_ade_m": "min\nADE",
    "min_fde_m": "min\nFDE",
    "min_sfde_m": "min\nSFDE",
    "fdd_m": "FDD",
    "energy_m": "energy\nscore",
    "jsd_speed": "JSD\nspeed",
    "jsd_accel": "JSD\naccel",
    "collision_rate": "colli-\nsions",
    "off_road_rate": "off\nroad",
    "standing_rate": "stand",
}
_TABLE_WIDTH = 128

if TYPE_CHECKING:
    import torch

    from advdiff_sumo.models.bundle import Bundle
    from advdiff_sumo.training.dataset import WindowSet
    from advdiff_sumo.training.evaluation import EvaluationSettings, Figures


def evaluate(
    weights: Annotated[Path, typer.Option(help="A .safetensors file, or the --out of a training.")],
    data: flags.Data,
    out: Annotated[
        Path | None, typer.Option(help="Write the figures to this JSON file.", show_default=False)
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="All drives, not only those that train holds out.")
    ] = False,
    held_out: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of drives held out, as in train.")
    ] = 0.1,
    split_seed: Annotated[int, typer.Option(help="Which ones, as in train.")] = 0,
    windows: Annotated[int, typer.Option(min=0, help="Most windows looked at; 0: all.")] = 512,
    samples: Annotated[int, typer.Option(min=1, help="Joint samples of each scene.")] = 10,
    steps: Annotated[int, typer.Option(min=1, help="Denoising steps.")] = 10,
    seed: Annotated[int, typer.Option(help="Of the samples.")] = 0,
    device: flags.Device = "auto",
    threads: flags.Threads = None,
) -> None:
    """Judge weights on window files, open loop, beside baselines and the log itself.

    advdiff-sumo evaluate --weights runs/denoiser --data windows
    """
    from advdiff_sumo.models.bundle import load_bundle  # late: --help needs no PyTorch
    from advdiff_sumo.training.dataset import read_window_set, split
    from advdiff_sumo.training.evaluation import EvaluationSettings
    from advdiff_sumo.training.setup import choose_device, weights_file

    flags.use_threads(threads)
    bundle = load_bundle(weights_file(weights))
    window_set = read_window_set(data)
    if not everything:
        window_set = split(window_set, held_out, split_seed)[1]
    judging = EvaluationSettings(samples=samples, steps=steps, windows=windows or None, seed=seed)
    judge_and_show(bundle, window_set, judging, choose_device(device), out)


def judge_and_show(
    bundle: Bundle, windows: WindowSet, judging: EvaluationSettings, device: torch.device, out: Path | None
) -> None:
    """Judge *bundle* on *windows*, print the table, and write the figures to *out* unless it is None.

    Raises:
        FileError: *out* cannot be written; checked first, since judging takes minutes.
    """
    from advdiff_sumo.training.evaluation import evaluate_bundle, write_figures

    if out is not None:
        check_writable(out)
    with progress_bar(terminal(stderr=True), transient=True) as bar:
        task = bar.add_task("windows judged", total=None)
        figures = evaluate_bundle(
            bundle,
            windows,
            judging,
            device,
            lambda done, total: bar.update(task, completed=done, total=total),
        )
    terminal(width=max(terminal().width, _TABLE_WIDTH)).print(table(figures))
    if out is not None:
        write_figures(out, figures, judging, windows)


def table(figures: dict[str, Figures]) -> Table:
    """Return *figures*, by predictor (the model, the baselines and the log), as a table with one row for each."""
    from advdiff_sumo.training.evaluation import columns

    names = columns(figures)
    printed = Table(box=SIMPLE, padding=(0, 1), caption="errors in metres, rates of vehicles")
    printed.add_column("", no_wrap=True)
    for name in names:
        printed.add_column(_HEADS[name], justify="right", no_wrap=True)
    for predictor, row in figures.items():
        printed.add_row(predictor, *(_cell_text(name, row.get(name)) for name in names))
    return printed


def _cell_text(name: str, value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.1%}" if name.endswith("_rate") else f"{value:.{3 if name.startswith('jsd') else 2}f}"
