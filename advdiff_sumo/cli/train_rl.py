"""``advdiff-sumo train-rl``: train the attacker of background adv-rl."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from advdiff_sumo.cli.interruption import training_into
from advdiff_sumo.cli.terminal import progress_bar, terminal
from advdiff_sumo.cli.train import claim
from advdiff_sumo.cli.train_flags import Resume
from advdiff_sumo.config import set_dotted
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.wording import counted

if TYPE_CHECKING:
    from advdiff_sumo.rl.rl_options import AdversaryOptions, PpoOptions
    from advdiff_sumo.training.checkpoint import TrainingProgress as State
    from advdiff_sumo.training.history import Record


def train_rl(
    out: Annotated[Path, typer.Option(help="Folder for the actor, checkpoint, curves and metrics.")],
    net: Annotated[
        list[str] | None,
        typer.Option(help="SUMO net or shipped one; may be given several times.", show_default="downtown"),
    ] = None,
    target: Annotated[
        list[str] | None,
        typer.Option(help="What drives the target; may be given several times.", show_default="IDM"),
    ] = None,
    steps: Annotated[
        int,
        typer.Option(
            min=1, help="Decisions of the attacker, half a second each; rounded up to whole updates."
        ),
    ] = 50_000,
    seed: Annotated[int, typer.Option(min=0, help="Same seed and as many workers, same bytes.")] = 0,
    prior: Annotated[
        str | None,
        typer.Option(help="Behaviour model to deviate from: simnet or traffic.", show_default="simnet"),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Environments, each in a process of its own.")] = 1,
    assign: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="Any other option, as NAME=VALUE: --set ppo.n_steps=128, --set horizon_s=10."
        ),
    ] = None,
    resume: Resume = False,
) -> None:
    r"""Train the attacker of background adv-rl by PPO in closed loop with SUMO.

    advdiff-sumo train-rl --net downtown --target lane_graph --out runs/attacker

    Then: advdiff-sumo run --background adv-rl --weights runs/attacker/actor.safetensors

    --out gets actor.safetensors, checkpoint.safetensors (for --resume), metrics.jsonl, curves.png and events for
    TensorBoard. Ctrl-C leaves with the last update. Needs: pip install 'advdiff-sumo\[rl]'.
    """
    import advdiff_sumo.rl  # noqa: F401 - imported first: its error names a missing extra
    from advdiff_sumo.rl.sources import check
    from advdiff_sumo.rl.train import ACTOR, PpoTraining, train

    cli_options: dict[str, Any] = {"nets": net, "targets": target, "prior": prior}
    adversary, ppo = _options({key: value for key, value in cli_options.items() if value}, assign or [])
    training = PpoTraining(out, steps, seed, adversary, ppo, workers)
    check(adversary)
    claim(out, resume)
    console = terminal(stderr=True, highlight=False)
    with training_into(out), progress_bar(console) as bar:
        task = bar.add_task("steps", total=steps)

        def show(done: int, history: list[Record]) -> None:
            bar.update(task, completed=done, description=_progress_text(history))

        state = train(training, resume, show)
    _print_result(console, out / ACTOR, state)


def _options(cli_options: dict[str, Any], assignments: list[str]) -> tuple[AdversaryOptions, PpoOptions]:
    """Return the options of the environment, and those of PPO, which are set as ``ppo.NAME``.

    Raises:
        ConfigError: an option is unknown or unusable.
    """
    from advdiff_sumo.rl.rl_options import PpoOptions, adversary_options

    values = dict(cli_options)
    for assignment in assignments:
        set_dotted(values, assignment)
    ppo = values.pop("ppo", {})
    if not isinstance(ppo, dict):
        raise ConfigError("ppo is a group of options; set one of them, such as ppo.n_steps")
    return adversary_options(values), PpoOptions.parse(ppo, "options of ppo")


def _progress_text(history: list[Record]) -> str:
    """Return the text of the progress bar: mean reward and collisions of the last update, if there is one."""
    if not history or "reward" not in history[-1]["train"]:
        return "steps"
    last = history[-1]["train"]
    return f"reward {last['reward']:.2f} · collisions {100.0 * last['collision']:.0f} %"


def _print_result(console: Console, actor: Path, state: State) -> None:
    """Print the numbers of steps and updates, and how the reward has changed."""
    rewards = [r["train"]["reward"] for r in state.history if "reward" in r["train"]]
    change = f": reward {rewards[0]:.2f} → {rewards[-1]:.2f} an episode" if len(rewards) > 1 else ""
    console.print(
        f"{actor}: {counted(state.step, 'step')}, {counted(len(state.history), 'update')}{change}",
        soft_wrap=True,
    )
