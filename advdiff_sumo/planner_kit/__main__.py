"""Serves a planner from the command line: ``python -m advdiff_sumo.planner_kit my_planner:MyPlanner``."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from typing import Any

from advdiff_sumo.planner_kit.planner_server import serve


def main() -> None:
    """Serve the planner that the command line names."""
    parser = argparse.ArgumentParser(prog="python -m advdiff_sumo.planner_kit", description=main.__doc__)
    parser.add_argument("planner", help="package.module:Class")
    parser.add_argument(
        "--address", help="HOST:PORT or unix:PATH; by default what exec: asks for, else port 50051"
    )
    parser.add_argument("--options", default="{}", help="keyword arguments of the class, as JSON")
    parser.add_argument(
        "--read-road", help="makes the map out of the net's path: advdiff_sumo.maps:RoadMap.read"
    )
    args = parser.parse_args()
    sys.path.insert(0, "")
    try:
        planner_class = attribute(args.planner)
        read_road = attribute(args.read_road) if args.read_road else None
        options = json.loads(args.options)
    except (ImportError, AttributeError, ValueError) as error:
        parser.error(str(error))
    planner = planner_class(**options)
    serve(planner, args.address, name=args.planner, read_road=read_road)


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
