"""Draw a net and its side-car: `python tools/render_net.py NET -o PNG [--window X0 Y0 X1 Y1]`."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")  # draws to a file without a display
import matplotlib.pyplot as plt
import numpy as np
import shapely
import sumolib
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from shapely import LineString

FILLS = {
    "drivable_area": ("#6d7278", 1.0),
    "drivable_area_hole": ("#cfdcc4", 2.0),
    "walkway": ("#d9cfc1", 3.0),
}
GROUND = "#e4ebdc"
FALLBACK = "#6d7278"
BEYOND_TYPE = (
    "beyond_rim"  # type of streets and return edges beyond the rim of a map; side-cars do not cover them
)
BEYOND = "#a9adb2"
SIGNAL = {"G": "#2fbf4f", "g": "#9ad14b", "y": "#f0c419", "r": "#e0413a", "s": "#e0413a", "o": "#f0c419"}


def draw(net_file: Path, target: Path, window: list[float] | None, pixels: int, paths: bool) -> None:
    """Draw a net to a PNG with about `pixels` on its longer side; `paths`: with the paths through junctions."""
    net = sumolib.net.readNet(str(net_file), withInternal=True, withPrograms=True)
    x0, y0, x1, y1 = window or _bounds(net)
    size = pixels / 100 / max(x1 - x0, y1 - y0)
    figure, axes = plt.subplots(figsize=((x1 - x0) * size, (y1 - y0) * size), dpi=100)
    axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal")
    axes.set_axis_off()
    figure.subplots_adjust(0, 0, 1, 1)
    figure.patch.set_facecolor(GROUND)
    scale = pixels / max(x1 - x0, y1 - y0) * 72 / 100  # points per metre
    _draw_area(axes, net, net_file)
    _draw_markings(axes, net, scale)
    if paths:
        _draw_paths(axes, net)
    _draw_signals(axes, net, scale)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, facecolor=GROUND, metadata={"Software": None})
    plt.close(figure)


def _bounds(net: Any) -> tuple[float, float, float, float]:
    x0, y0, x1, y1 = net.getBoundary()
    return x0 - 8, y0 - 8, x1 + 8, y1 + 8


def _draw_area(axes: Axes, net: Any, net_file: Path) -> None:
    side_car = net_file.with_name(net_file.name.split(".net.xml")[0] + ".poly.xml")
    if side_car.exists():
        polygons = list(sumolib.shapes.polygon.read(str(side_car)))
        for kind, (colour, order) in FILLS.items():
            shapes = [p.shape for p in polygons if p.type == kind]
            axes.add_collection(PolyCollection(shapes, facecolors=colour, linewidths=0, zorder=order))
        beyond = [edge for edge in net.getEdges(withInternal=False) if edge.getType() == BEYOND_TYPE]
        nodes = {node for edge in beyond for node in (edge.getFromNode(), edge.getToNode())}
        _draw_carriageway(axes, beyond, nodes, BEYOND, 0.5)
        return
    _draw_carriageway(axes, net.getEdges(), net.getNodes(), FALLBACK, 2.0)


def _draw_carriageway(
    axes: Axes, edges: Iterable[Any], nodes: Iterable[Any], colour: str, order: float
) -> None:
    bands = [
        LineString(lane.getShape()).buffer(lane.getWidth() / 2, cap_style="flat").exterior.coords
        for edge in edges
        for lane in edge.getLanes()
    ]
    shapes = [node.getShape() for node in nodes if len(node.getShape()) > 2]
    areas = [np.asarray(a) for a in bands] + [np.asarray(s) for s in shapes]
    axes.add_collection(PolyCollection(areas, facecolors=colour, linewidths=0, zorder=order))


def _draw_markings(axes: Axes, net: Any, scale: float) -> None:
    kerb_side = -1.0 if not _lefthand(net) else 1.0
    solid: list[np.ndarray] = []
    dashed: list[np.ndarray] = []
    for edge in net.getEdges(withInternal=False):
        lanes = edge.getLanes()
        for i, lane in enumerate(lanes):
            line = LineString(lane.getShape())
            half = lane.getWidth() / 2
            solid += _side(line, kerb_side * half) if i == 0 else []
            (solid if i == len(lanes) - 1 else dashed).extend(_side(line, -kerb_side * half))
    width = max(0.25, 0.14 * scale)
    axes.add_collection(LineCollection(solid, colors="white", linewidths=width, zorder=4))
    dashes = (0, (3.0 * scale / width, 3.0 * scale / width))
    axes.add_collection(
        LineCollection(dashed, colors="white", linewidths=width, linestyles=[dashes], zorder=4)
    )


def _side(line: LineString, offset_m: float) -> list[np.ndarray]:
    """Return *line* shifted to the left; it may consist of several parts if a bend is narrower than the offset."""
    return [
        shapely.get_coordinates(part)
        for part in shapely.get_parts(line.offset_curve(offset_m, join_style="mitre"))
    ]


def _lefthand(net: Any) -> bool:
    """Return whether lane 0 is the leftmost, as sumolib does not read the net's flag; False for single lanes."""
    lanes = (edge.getLanes() for edge in net.getEdges(withInternal=False) if edge.getLaneNumber() > 1)
    pair = next(lanes, None)
    if pair is None:
        return False
    kerb, inner = (np.asarray(lane.getShape()[:2]) for lane in pair[:2])
    ahead, across = kerb[1] - kerb[0], inner[0] - kerb[0]
    return bool(ahead[0] * across[1] - ahead[1] * across[0] < 0)  # lane 1 lies right of lane 0


def _draw_paths(axes: Axes, net: Any) -> None:
    internal = [e for e in net.getEdges() if e.getFunction() == "internal"]
    shapes = [lane.getShape() for edge in internal for lane in edge.getLanes()]
    axes.add_collection(LineCollection(shapes, colors="#ffd76a", linewidths=0.6, alpha=0.7, zorder=5))


def _draw_signals(axes: Axes, net: Any, scale: float) -> None:
    for light in net.getTrafficLights():
        program = next(iter(light.getPrograms().values()))
        state = program.getPhases()[0].state
        for lane, _, index in light.getConnections():
            (xa, ya), (xb, yb) = lane.getShape()[-2:]
            across = np.array([-(yb - ya), xb - xa]) / np.hypot(xb - xa, yb - ya) * lane.getWidth() * 0.42
            ends = np.array([xb, yb]) + np.outer([-1.0, 1.0], across)
            colour = SIGNAL.get(state[index], "#888888")
            axes.plot(*ends.T, color=colour, linewidth=max(1.0, 0.7 * scale), solid_capstyle="butt", zorder=6)


def main() -> None:
    """Draw the net that the command line names."""
    parser = argparse.ArgumentParser(description="Draw a SUMO net with its side-car, markings and signals.")
    parser.add_argument("net", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True, help="PNG to write")
    parser.add_argument("--window", type=float, nargs=4, metavar=("X0", "Y0", "X1", "Y1"), help="metres")
    parser.add_argument("--pixels", type=int, default=1600, help="length of the longer side")
    parser.add_argument("--paths", action="store_true", help="draw the paths through junctions too")
    options = parser.parse_args()
    draw(options.net, options.out, options.window, options.pixels, options.paths)


if __name__ == "__main__":
    main()
