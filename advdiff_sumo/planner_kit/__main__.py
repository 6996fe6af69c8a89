"""``python -m advdiff_sumo.planner_kit my_planner:MyPlanner``: serve a planner without a line of code."""

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
    given = parser.parse_args()
    sys.path.insert(0, "")
    try:
        made, read_road = attribute(given.planner), attribute(given.read_road) if given.read_road else None
        options = json.loads(given.options)
    except (ImportError, AttributeError, ValueError) as error:
        parser.error(str(error))
    planner = made(**options)
    serve(planner, given.address, name=given.planner, read_road=read_road)


def attribute(name: str) -> Any:
    """Return what ``package.module:attribute`` stands for."""
    module, colon, path = name.partition(":")
    if not colon:
        raise ValueError(f"{name}: expected package.module:Class")
    value: Any = importlib.import_module(module)
    for part in path.split("."):
        value = getattr(value, part)
    return value


if __name__ == "__main__":
    main()
