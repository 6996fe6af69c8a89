"""``advdiff-sumo warmup``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any

import typer

from advdiff_sumo.cli import run_flags as flags
from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.core.threads import one_thread_for_good

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
) -> None:
    """Meet a target for the first time, and learn from few plans what it fails in.

    advdiff-sumo warmup --target lane_graph --net motorway --out seen.safetensors

    Then: advdiff-sumo run --target lane_graph --background scripted --reward seen.safetensors

    Under a licence this is which lawful encounters break the target, for scripted and diffusion; with --licence
    reckless the reward model of diffusion is refitted, as in the paper.
    """
    one_thread_for_good()
    from advdiff_sumo.cli.run import options_given

    if out.suffix != ".safetensors":
        raise ConfigError(f"--out {out}: give a name that ends in .safetensors")
    if not out.parent.is_dir():
        raise FileError(out.parent, "no such folder", "make it, or choose another --out")
    policy = {
        "licence": licence,
        "strength": strength,
        "attackers": attackers,
        "attack": attack,
        "weights": flags.weights_of(weights),
        "device": device,
    }
    reckless = licence == "reckless"
    background = background or ("diffusion" if reckless else "scripted")
    given: dict[str, Any] = {"net": net, "target": target, "seed": seed, "horizon_s": horizon}
    options = options_given(None, given | {"background": background}, policy, assign or [], defect)
    (_refit_reward if reckless else _learn_failures)(options, steps, out)


def _learn_failures(options: RunOptions, steps: int, out: Path) -> None:
    from advdiff_sumo.experiments.failure_warmup import header, promises, warm_up_failures
    from advdiff_sumo.models.failure_predictor import save_failures

    done = _with_bar(steps, lambda tell: warm_up_failures(options, steps, tell))
    save_failures(done.predictor, out, header(options, done))
    console = terminal()
    console.print(
        f"{done.plans} plans in {done.episodes} episodes, {len(done.outcomes)} encounters, "
        f"{done.failures} valid failures"
    )
    likely = ", ".join(f"{kind} {share:.0%}" for kind, share in promises(done.predictor).items())
    console.print(f"expected to fail in: {likely}", soft_wrap=True)
    console.print(f"use it with run --background {options.background} --reward {out}", soft_wrap=True)


def _refit_reward(options: RunOptions, steps: int, out: Path) -> None:
    from advdiff_sumo.experiments.warmup_run import description, warm_up
    from advdiff_sumo.models.reward import save_reward

    done = _with_bar(steps, lambda tell: warm_up(options, steps, tell))
    save_reward(done.reward, out, description(options, done))
    early, late = done.losses[: len(done.losses) // 2], done.losses[len(done.losses) // 2 :]
    console = terminal()
    console.print(
        f"{done.steps} plans in {done.episodes} episodes, {done.contacts} collisions; "
        f"loss {fmean(early or late):.4f} → {fmean(late):.4f}"
    )
    console.print(
        f"reward model: {out}  ·  use it with run --background diffusion --licence reckless --reward {out}",
        soft_wrap=True,
    )


def _with_bar(steps: int, work: Callable[[Callable[[int], None]], Any]) -> Any:
    """Return what *work* returns; it tells a bar how many of *steps* plans are made."""
    from advdiff_sumo.cli.terminal import progress_bar

    with progress_bar(terminal()) as progress:
        task = progress.add_task("warm-up", total=steps)
        return work(lambda count: progress.update(task, completed=count))
