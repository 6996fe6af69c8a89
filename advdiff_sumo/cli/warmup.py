"""``advdiff-sumo warmup``."""

from __future__ import annotations

from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

import typer

from advdiff_sumo.cli import run_flags as flags
from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.core.threads import one_thread_for_good


def warmup(
    out: Annotated[Path, typer.Option(help="File for the reward model, .safetensors.")],
    target: flags.Target = None,
    net: flags.Net = None,
    steps: Annotated[
        int, typer.Option(min=1, help="Plans to learn from, the paper's interactive steps.")
    ] = 90,
    seed: flags.Seed = None,
    horizon: flags.Horizon = None,
    strength: flags.Strength = None,
    attackers: flags.Attackers = None,
    attack: flags.Attack = None,
    weights: flags.Weights = None,
    device: flags.Device = None,
) -> None:
    """Let guided traffic meet a target for the first time, and refit only its reward model.

    advdiff-sumo warmup --target lane_graph --out q.safetensors

    Then: advdiff-sumo run --target lane_graph --background diffusion --reward q.safetensors
    """
    one_thread_for_good()
    from advdiff_sumo.cli.terminal import progress_bar
    from advdiff_sumo.experiments.warmup_run import description, warm_up
    from advdiff_sumo.models.reward_file import save_reward
    from advdiff_sumo.sim.run_episodes import RunOptions

    if out.suffix != ".safetensors":
        raise ConfigError(f"--out {out}: give a name that ends in .safetensors")
    if not out.parent.is_dir():
        raise FileError(out.parent, "no such folder", "make it, or choose another --out")
    policy = {
        "licence": "reckless",  # a manoeuvre driven in a guided plan's place says nothing of that plan's latents
        "strength": strength,
        "attackers": attackers,
        "attack": attack,
        "weights": flags.weights_of(weights),
        "device": device,
    }
    given: dict[str, Any] = {"net": net, "target": target, "seed": seed, "horizon_s": horizon}
    values = {key: value for key, value in given.items() if value is not None}
    values["background"] = "diffusion"
    values["background_options"] = {key: value for key, value in policy.items() if value is not None}
    options = RunOptions.parse(values)
    console = terminal()
    with progress_bar(console) as progress:
        task = progress.add_task("warm-up", total=steps)
        done = warm_up(options, steps, lambda count: progress.update(task, completed=count))
    save_reward(done.reward, out, description(options, done))
    early, late = done.losses[: len(done.losses) // 2], done.losses[len(done.losses) // 2 :]
    console.print(
        f"{done.steps} plans in {done.episodes} episodes, {done.contacts} collisions; "
        f"loss {fmean(early or late):.4f} → {fmean(late):.4f}"
    )
    console.print(
        f"reward model: {out}  ·  use it with run --background diffusion --reward {out}", soft_wrap=True
    )
