"""``advdiff-sumo warmup``: learn in which encounters a target fails."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from advdiff_sumo.cli import run_flags as flags
from advdiff_sumo.cli.terminal import progress_bar, terminal
from advdiff_sumo.cli.worker_flags import Timeout, end_as_by_ctrl_c, limits_of
from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.core.threads import one_thread_for_good
from advdiff_sumo.core.whole_file import check_writable

if TYPE_CHECKING:
    from advdiff_sumo.sim.run_episodes import RunOptions


def warmup(
    out: Annotated[Path, typer.Option(help="File for what is learned, .safetensors.")],
    target: flags.Target = None,
    background: Annotated[
        str | None,
        typer.Option(
            help="Who meets the target: scripted or diffusion.",
            show_default="scripted; diffusion with --licence reckless",
        ),
    ] = None,
    net: flags.Net = None,
    steps: Annotated[
        int, typer.Option(min=1, help="Plans to learn from, the paper's interactive steps.")
    ] = 90,
    seed: flags.Seed = None,
    horizon: flags.Horizon = None,
    licence: flags.Licence = None,
    strength: flags.Strength = None,
    attackers: flags.Attackers = None,
    attack: flags.Attack = None,
    weights: flags.Weights = None,
    device: flags.Device = None,
    assign: flags.Assign = None,
    defect: flags.Defect = None,
    timeout: Timeout = 600.0,
) -> None:
    """Learn in a few plans which encounters a target fails in, for run --reward.

    advdiff-sumo warmup --target lane_graph --net motorway --out seen.safetensors

    Then: advdiff-sumo run --target lane_graph --background scripted --reward seen.safetensors

    Under a licence this is which lawful encounters break the target, for scripted and diffusion; with --licence
    reckless the reward model of diffusion is refitted, as in the paper.

    The planner is met in a process of its own: one that crashes, hangs or leaves ends the warm-up with a sentence.
    """
    end_as_by_ctrl_c()
    one_thread_for_good()
    from advdiff_sumo.cli.run import options_given

    _check_out(out)
    policy: dict[str, Any] = {"licence": licence, "strength": strength, "attackers": attackers}
    policy |= {"attack": attack, "weights": flags.weights_of(weights), "device": device}
    background = background or ("diffusion" if licence == "reckless" else "scripted")
    cli_options: dict[str, Any] = {"net": net, "target": target, "seed": seed, "horizon_s": horizon}
    options = options_given(None, cli_options | {"background": background}, policy, assign or [], defect)
    for line in _warm_up(options, steps, out, licence, timeout):
        terminal().print(line, soft_wrap=True)


def _check_out(out: Path) -> None:
    """Check that the file *out* can be written; FileError if not, ConfigError unless it is a .safetensors file."""
    if out.suffix != ".safetensors":
        raise ConfigError(f"--out {out}: give a name that ends in .safetensors")
    if not out.parent.is_dir():
        raise FileError(out.parent, "no such folder", "make it, or choose another --out")
    check_writable(out)


def _warm_up(
    options: RunOptions, steps: int, out: Path, licence: str | None, timeout_s: float
) -> Sequence[str]:
    """Learn from *steps* plans with a progress bar; return the lines to print about the result."""
    from advdiff_sumo.experiments.warmup_worker import warm_up_in_worker  # late: --help needs no simulator

    with ExitStack() as stack:
        limits = limits_of(stack, math.inf, memory_mb=0)
        progress = stack.enter_context(progress_bar(terminal()))
        task = progress.add_task("warm-up", total=steps)
        lines = warm_up_in_worker(
            options,
            steps,
            out,
            licence,
            limits,
            timeout_s,
            lambda plans: progress.update(task, completed=plans),
            lambda line: typer.echo(line, err=True),
        )
        progress.update(task, completed=steps)
    return lines
