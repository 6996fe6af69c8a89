"""Serves a planner from the command line: ``python -m advdiff_sumo.planner_kit my_planner:MyPlanner``."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from collections.abc import Callable
from typing import Any

from advdiff_sumo.core.plug_in_source import call_problem, described, raised_at
from advdiff_sumo.planner_kit.planner_server import serve


def main() -> None:
    """Serve the planner that the command line names; what cannot be used is one sentence on stderr, exit code 2."""
    parser = _parser()
    args = parser.parse_args()
    sys.path.insert(0, "")
    try:
        options = options_of(args.options)
        planner = _made(f"planner '{args.planner}'", lambda: attribute(args.planner)(**options))
        if problem := call_problem(planner):
            raise ValueError(f"planner '{args.planner}' {problem}")
        read_road = args.read_road and _made(
            f"--read-road {args.read_road}", lambda: attribute(args.read_road)
        )
    except ValueError as error:
        parser.error(str(error))
    try:
        serve(planner, args.address, name=args.planner, read_road=read_road)
    except RuntimeError as error:  # the server cannot listen there
        parser.error(f"{error}; choose another --address")


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m advdiff_sumo.planner_kit",
        description="Serve the planner that the command line names.",
    )
    parser.add_argument("planner", help="package.module:Class")
    parser.add_argument(
        "--address", help="HOST:PORT or unix:PATH; by default what exec: asks for, else port 50051"
    )
    parser.add_argument("--options", default="{}", help="keyword arguments of the class, as JSON")
    parser.add_argument(
        "--read-road", help="makes the map out of the net's path: advdiff_sumo.maps:RoadMap.read"
    )
    return parser


def options_of(text: str) -> dict[str, Any]:
    """Return the keyword arguments of a planner that *text*, a JSON object, holds.

    Raises:
        ValueError: *text* is no JSON object.
    """
    remedy = """give a JSON object, such as '{"speed_mps": 3}'"""
    try:
        options = json.loads(text)
    except ValueError as error:
        raise ValueError(f"--options {text}: {error}; {remedy}") from None
    if not isinstance(options, dict):
        raise ValueError(f"--options {text}: it is no object; {remedy}")
    return options


def _made(what: str, make: Callable[[], Any]) -> Any:
    """Return what *make* returns.

    Raises:
        ValueError: it raised an exception or tried to end the process; *what* is the beginning of the message.
    """
    try:
        return make()
    except (Exception, SystemExit) as error:
        raise ValueError(f"{what} cannot be made: {described(error)}{raised_at(error, None)}") from error


def attribute(name: str) -> Any:
    """Return the object that *name* (``package.module:attribute``) denotes."""
    module, colon, path = name.partition(":")
    if not colon:
        raise ValueError(f"{name}: expected package.module:Class")
    value: Any = importlib.import_module(module)
    for part in path.split("."):
        value = getattr(value, part)
    return value


if __name__ == "__main__":
    main()
