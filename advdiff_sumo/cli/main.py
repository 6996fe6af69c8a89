"""The command ``advdiff-sumo``: its verbs and the handling of errors."""

from __future__ import annotations

import inspect
import logging
import sys
from typing import Annotated, NoReturn

import typer

from advdiff_sumo import __version__
from advdiff_sumo.cli.bench import bench
from advdiff_sumo.cli.check_planner import check_planner
from advdiff_sumo.cli.check_policy import check_policy
from advdiff_sumo.cli.compare import compare
from advdiff_sumo.cli.convert import convert
from advdiff_sumo.cli.data import data
from advdiff_sumo.cli.defects import defects
from advdiff_sumo.cli.doctor import doctor
from advdiff_sumo.cli.evaluate import evaluate
from advdiff_sumo.cli.export import export
from advdiff_sumo.cli.figure import figure
from advdiff_sumo.cli.interruption import Interrupted
from advdiff_sumo.cli.list_names import list_names
from advdiff_sumo.cli.margin import margin
from advdiff_sumo.cli.planner_kit import planner_kit
from advdiff_sumo.cli.replay import replay
from advdiff_sumo.cli.report import report
from advdiff_sumo.cli.results import results
from advdiff_sumo.cli.run import run
from advdiff_sumo.cli.sweep import sweep
from advdiff_sumo.cli.system_errors import checked_folder, system_error
from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.cli.train import train
from advdiff_sumo.cli.train_rl import train_rl
from advdiff_sumo.cli.verdict import verdict
from advdiff_sumo.cli.video import video
from advdiff_sumo.cli.warmup import warmup
from advdiff_sumo.core.errors import INTERRUPTED, INTERRUPTION, AdvdiffError

INPUT_ERROR = 2
#: Words with which pydantic, which checks typer's options, begins a message in the middle of typer's sentence.
_PLAIN_WORDS = {": Value error, ": ": ", ": Input should": ": input should"}

app = typer.Typer(
    name="advdiff-sumo",
    help="Find the traffic situations in which a driving planner fails: closed-loop adversarial traffic on SUMO.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("run")(run)
app.command("convert")(convert)
app.command("sweep")(sweep)
app.command("results")(results)
app.command("compare")(compare)
app.command("verdict")(verdict)
app.command("replay")(replay)
app.command("report")(report)
app.command("figure")(figure)
app.command("video")(video)
app.add_typer(data)
app.add_typer(bench)
app.command("train")(train)
app.command("train-rl")(train_rl)
app.command("evaluate")(evaluate)
app.command("warmup")(warmup)
app.command("export")(export)
app.command("check-planner")(check_planner)
app.command("check-policy")(check_policy)
app.command("margin")(margin)
app.command("list")(list_names)
app.command("defects")(defects)
app.command("planner-kit")(planner_kit)
app.command("doctor")(doctor)


def _joined_paragraphs(text: str) -> str:
    """Return *text* with each paragraph in one line, so that the help breaks lines at the terminal's width."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


for group in (app, data, bench):
    for command in group.registered_commands:
        command.help = _joined_paragraphs(inspect.getdoc(command.callback) or "")


def _print_version(is_given: bool) -> None:
    """Print the version and exit if ``--version`` is given."""
    if is_given:
        typer.echo(f"advdiff-sumo {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[  # noqa: ARG001 - its callback prints it
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and leave."
        ),
    ] = False,
    verbose: Annotated[
        int,
        typer.Option(
            "--verbose", "-v", count=True, help="Log to standard error: -v what is done, -vv details."
        ),
    ] = 0,
) -> None:
    """Verbs are listed below; each has its own --help."""
    if verbose:
        level = logging.DEBUG if verbose > 1 else logging.INFO
        logging.basicConfig(format="%(relativeCreated)7.0f ms %(name)s: %(message)s")
        logging.getLogger("advdiff_sumo").setLevel(level)


def main() -> None:
    """Run the command line and exit; an error that the user can correct is one sentence on stderr, exit code 2."""
    message = INTERRUPTION
    try:
        here = checked_folder()
        if here not in sys.path:
            sys.path.insert(0, here)  # a user's own planner may lie here, as with python -m
        code = app(prog_name="advdiff-sumo", standalone_mode=False)
    except AdvdiffError as error:
        _refuse(str(error))
    except OSError as error:
        sentence = system_error(error)
        if sentence is None:
            raise
        _refuse(sentence)
    except typer.TyperException as error:
        _refuse(_usage_error(error))
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except Interrupted as interrupted:
        code, message = INTERRUPTED, str(interrupted)
    if code == INTERRUPTED:
        # If Ctrl-C interrupted an exec of a text, as in dataclasses, Python would end by the signal.
        exec("")  # noqa: S102 - it resets that state
        _print_error(message, "yellow")
    sys.exit(code)


def _print_error(sentence: str, style: str) -> None:
    terminal(stderr=True, soft_wrap=True, highlight=False).print(sentence, style=style)


def _refuse(sentence: str) -> NoReturn:
    """Print *sentence* as an error, in one line, and exit with code 2; print nothing if it is empty."""
    line = " ".join(sentence.split())
    if line:
        _print_error(f"error: {line}", "red")
    sys.exit(INPUT_ERROR)


def _usage_error(error: typer.TyperException) -> str:
    """Return what is wrong with the command line, and which help to read; "" if typer has printed the help already."""
    problem = error.format_message().strip().rstrip(".")
    for of_pydantic, plain in _PLAIN_WORDS.items():
        problem = problem.replace(of_pydantic, plain)
    context = getattr(error, "ctx", None)
    verb = next((word for word in sys.argv[1:] if not word.startswith("-")), "")
    command = context.command_path if context else f"{app.info.name} {verb}".strip()
    return f"{problem[0].lower()}{problem[1:]} (see {command} --help)" if problem else ""
