"""Evaluate OpenDRIVE files, written from the standard alone, to check what the converter writes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lxml import etree

from advdiff_sumo.core.arrays import FloatArray

STEP_M = 0.25
FINE_M = 0.005


@dataclass(frozen=True, eq=False)
class EvaluatedRoad:
    """The one lane of a road: centre (N, 2), both borders (N, 2), and the reference line's yaw (N,) in rad."""

    name: str
    centre_m: FloatArray
    left_m: FloatArray
    right_m: FloatArray
    yaw_rad: FloatArray
    predecessor: str | None
    successor: str | None
    jumps_m: float
    kinks_rad: float


def evaluate(path: Path) -> dict[str, EvaluatedRoad]:
    """Return the roads of *path* by id."""
    root = etree.parse(str(path)).getroot()
    return {road.get("id"): _road(road) for road in root.iterfind("road")}


def _road(road: etree._Element) -> EvaluatedRoad:
    s_all, xy_all, yaw_all, jumps, kinks = [], [], [], [0.0], [0.0]
    for piece in road.iterfind("planView/geometry"):
        s, xy, yaw = _piece(piece)
        if xy_all:
            jumps.append(float(np.hypot(*(xy[0] - xy_all[-1][-1]))))
            kinks.append(abs(float((yaw[0] - yaw_all[-1][-1] + np.pi) % (2.0 * np.pi) - np.pi)))
            jumps.append(abs(float(s[0] - s_all[-1][-1])))
        s_all.append(s)
        xy_all.append(xy)
        yaw_all.append(yaw)
    s, xy, yaw = np.concatenate(s_all), np.vstack(xy_all), np.concatenate(yaw_all)
    jumps.append(abs(float(s[-1]) - float(road.get("length"))))
    offset = _cubic(road.findall("lanes/laneOffset"), "s", s)
    (lane,) = road.findall("lanes/laneSection/right/lane")
    width = _cubic(lane.findall("width"), "sOffset", s)
    across = np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)
    sides = [xy + t[:, None] * across for t in (offset - 0.5 * width, offset, offset - width)]
    links = [road.find(f"link/{name}") for name in ("predecessor", "successor")]
    ids = [None if link is None else str(link.get("elementId")) for link in links]
    return EvaluatedRoad(str(road.get("name")), *sides, yaw, *ids, max(jumps), max(kinks))


def _piece(piece: etree._Element) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return arc lengths, points and yaws; turning pieces are integrated step by step (midpoint rule)."""
    s0, x, y, yaw, length = (float(piece.get(key)) for key in ("s", "x", "y", "hdg", "length"))
    (shape,) = [child for child in piece if child.tag != "userData"]
    if shape.tag == "paramPoly3":
        raise NotImplementedError("the converter writes no paramPoly3")
    first = float(shape.get("curvStart") or shape.get("curvature") or 0.0)
    last = float(shape.get("curvEnd") or shape.get("curvature") or 0.0)
    step = STEP_M if first == last == 0.0 else FINE_M
    s = np.linspace(0.0, length, max(2, int(np.ceil(length / step)) + 1))
    middle = 0.5 * (s[1:] + s[:-1])
    along = yaw + first * s + 0.5 * (last - first) * s**2 / length
    toward = yaw + first * middle + 0.5 * (last - first) * middle**2 / length
    ds = np.diff(s)
    steps = np.stack([np.cos(toward) * ds, np.sin(toward) * ds], axis=1)
    return s0 + s, np.cumsum(np.vstack(([x, y], steps)), axis=0), along


def _cubic(rows: list[etree._Element], start: str, s: FloatArray) -> FloatArray:
    """Return a piecewise cubic at *s*."""
    starts = np.array([float(row.get(start)) for row in rows])
    terms = np.array([[float(row.get(key)) for key in "abcd"] for row in rows])
    index = np.clip(np.searchsorted(starts, s + 1e-9, side="right") - 1, 0, None)
    ds = s - starts[index]
    return np.asarray((terms[index] * ds[:, None] ** np.arange(4)).sum(axis=1))
