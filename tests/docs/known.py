"""Check the words of a command: whether the command exists, with these options."""

from __future__ import annotations

import re
from typing import Any

import typer

from advdiff_sumo.cli.main import app
from advdiff_sumo.config import set_dotted
from advdiff_sumo.core.errors import AdvdiffError
from advdiff_sumo.export import EXPORTERS
from advdiff_sumo.maps.shipped_nets import find_net
from advdiff_sumo.planners.planner_registry import TARGETS
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.traffic.policy_registry import POLICIES
from advdiff_sumo.training.presets import STAGES, preset
from tests.docs.blocks import ROOT

OTHERS = {".", "apt-get", "cat", "cd", "cmake", "cmp", "git", "pip", "ray", "setup.sh"}
"""Programs by others; their arguments are not checked."""


def leaf(words: list[str]) -> tuple[Any, list[str]]:
    """Return the command of ``advdiff-sumo`` that *words* name, and the words after its name.

    Raises:
        KeyError: there is no such verb.
    """
    command, rest = typer.main.get_command(app), list(words[1:])
    while hasattr(command, "commands") and rest and not rest[0].startswith("-"):
        command = command.commands[rest.pop(0)]
    return command, rest


def options_of(command: Any) -> set[str]:
    """Return all options of *command*."""
    named = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    return {name for name in named if name.startswith("-")} | {"--help", "-h"}


def problem(words: list[str]) -> str:
    """Return what is wrong with a command; "" if nothing is."""
    program = words[0].rpartition("/")[2]
    if program == "advdiff-sumo":
        return _ours(words)
    if program == "make":
        targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
        return ", ".join(f"no target {word}" for word in words[1:] if word not in targets)
    if program in ("python", "pytest"):
        return _python(words[1:] if program == "python" else ["-m", *words])
    return "" if program in OTHERS else f"{words[0]} is no program that the tests know"


def _ours(words: list[str]) -> str:
    try:
        command, rest = leaf(words)
        if {"--help", "-h"} & {*rest} or hasattr(command, "commands"):
            unknown = [word for word in rest if word.startswith("-") and word not in options_of(command)]
            return ", ".join(f"no option {word}" for word in unknown)
        values = command.make_context(command.name, rest).params
        _check_values(command.name, values)
    except KeyError as error:
        return f"no verb {error}"
    except (AdvdiffError, typer.TyperException) as error:
        return str(error) or type(error).__name__
    return ""


def _check_values(verb: str, values: dict[str, Any]) -> None:
    """Check names and settings that the parser accepts as any text.

    Raises:
        AdvdiffError: a target, background, exporter or net is unknown, or a setting is refused.
    """
    for key, registry in (("target", TARGETS), ("background", POLICIES), ("formats", EXPORTERS)):
        if (verb, key) == ("verdict", "target"):
            continue  # for verdict, it is a road user of the file
        for name in _listed(values.get(key)):
            if name != "all" and ":" not in name:
                registry.canonical(name)
    for name in _listed(values.get("net")):
        if ".net.xml" not in name:
            find_net(name)
    if verb in ("run", "check-policy"):
        settings: dict[str, Any] = {}
        for assignment in values["assign"] or ():
            set_dotted(settings, assignment)
        RunOptions.parse(settings)
    if verb == "train":
        stage = STAGES[STAGES.index(values["stage"])]
        preset(values["preset"] or "small", stage, values["assign"] or [])


def _listed(value: str | list[str] | None) -> list[str]:
    """Return the values of an option as a list."""
    return [value] if isinstance(value, str) else value or []


def _python(words: list[str]) -> str:
    """Check that scripts and tests exist, and that a script's options occur in its source."""
    if words[:1] == ["-m"]:
        module, words = words[1], words[2:]
        if module.startswith("tests."):
            words = [module.replace(".", "/") + ".py", *words]
        elif module != "pytest":
            return "" if module == "venv" else f"no module {module}"
    paths = [word for word in words if word.startswith(("tools/", "tests/")) and "…" not in word]
    missing = [f"no file {path}" for path in paths if not (ROOT / path).exists()]
    if missing or not paths or not paths[0].endswith(".py") or "pytest" in words:
        return ", ".join(missing)
    if paths[0] == "tools/convert_nuscenes_map.py":
        command, _ = leaf(["advdiff-sumo", "convert"])
        known = options_of(command)
    else:
        known = set(re.findall(r"\"(--?[\w-]+)\"", (ROOT / paths[0]).read_text()))
    return ", ".join(
        f"no option {word}" for word in words if word.startswith("-") and word not in known | {"-k", "-m"}
    )
