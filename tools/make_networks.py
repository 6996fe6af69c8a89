"""Make the shipped networks: `python tools/make_networks.py downtown` writes networks/downtown.*.xml."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from networks_src import downtown, downtown_left, motorway, netconvert, sidecar
from networks_src.plain import Plan

from advdiff_sumo.maps.on_foot.add_paths import add_foot_paths


@dataclass(frozen=True)
class Recipe:
    """How to make a network.

    Attributes:
        plan: returns the layout.
        footway_m: width of the footways along kerbs; 0: none.
        crossings: whether pedestrians can walk and cross.
    """

    plan: Callable[[], Plan]
    footway_m: float = 2.5
    crossings: bool = False


RECIPES: dict[str, Recipe] = {
    "downtown": Recipe(downtown.plan),
    "downtown-left": Recipe(downtown_left.plan),
    "motorway": Recipe(motorway.plan, footway_m=0.0),
    "downtown-people": Recipe(downtown.plan, crossings=True),
}


def make(name: str, folder: Path) -> str:
    """Write NAME.net.xml and NAME.poly.xml into `folder`; return netconvert's warnings."""
    recipe = RECIPES[name]
    net_file = folder / f"{name}.net.xml"
    warnings = netconvert.build(recipe.plan(), net_file)
    poly_file = folder / f"{name}.poly.xml"
    sidecar.write(net_file, poly_file, name, recipe.footway_m)
    if recipe.crossings:  # after the side-car, whose areas must be those of the net without crossings
        add_foot_paths(net_file, [], guess=True)
    return warnings


def main() -> None:
    """Make the networks that the command line names; by default, all."""
    parser = argparse.ArgumentParser(description="Make the shipped networks and their side-cars.")
    parser.add_argument("names", nargs="*", choices=[*RECIPES, []], help="which (default: all)")
    default = Path(__file__).resolve().parent.parent / "networks"
    parser.add_argument("--out", type=Path, default=default, help="folder to write to (default: networks/)")
    options = parser.parse_args()
    for name in options.names or RECIPES:
        print(f"{name}: writing {name}.net.xml and {name}.poly.xml")
        sys.stderr.write(make(name, options.out))


if __name__ == "__main__":
    main()
