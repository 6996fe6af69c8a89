"""Reads and writes window files: training windows of one map as safetensors, with NumPy only (docs/data.md)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from advdiff_sumo.core.errors import FileError, os_reason
from advdiff_sumo.core.whole_file import whole_file

FORMAT = "advdiff-windows-1"
SUFFIX = ".safetensors"
DRIVEN = "driven_by"
"""Key in ``extra``: sha256 of the weights that drove the vehicles before the present instant of the windows."""
DT_S = 0.5
PAST, FUTURE = 5, 12
"""H and T: number of past instants, the present one included, and of future instants."""
MAX_AGENTS, CROP_M = 24, 60.0
"""Maximum number of agents in a window, and their largest distance from the focal one."""
_AGAIN = "build or copy it again"
_OWN_KEYS = frozenset({"format", "source", "map", "dt_s", "scene_names"})


@dataclass(frozen=True)
class WindowFile:
    """W windows of one map: S agent rows, H = 5 past instants, T = 12 future instants, M pieces, G signals.

    Arrays have the file's types. Entries whose mask is False are zero. Positions are in metres relative to
    ``map_origin``, yaw is counter-clockwise from east, speed is along the heading.

    Attributes:
        map_origin: (2,) float64; positions plus this are in the map's frame.
        map_xy: (M, N, 2) float32 points of the map's pieces.
        map_features: (M, F) float32, see :class:`advdiff_sumo.maps.vector_map.Feature`.
        map_signal: (M,) int32 index into the signals; −1 without a signal.
        offset: (W + 1,) int64; window w has the agent rows offset[w] to offset[w + 1], the focal agent first.
        past: (S, H, 4) float32 x, y, yaw, speed at −2 … 0 s.
        past_valid: (S, H) bool; True at the last instant.
        future: (S, T, 4) float32 x, y, yaw, speed at 0.5 … 6 s.
        future_valid: (S, T) bool.
        size: (S, 2) float32 length and width.
        classes: (S,) uint8 values of :class:`advdiff_sumo.core.scene.AgentClass`.
        parked: (S,) bool.
        near: (S, K) int32 pieces near the agent at present, padded with −1; lanes, then road edges.
        signals: (W, G) uint8 present states: 0 unknown, 1 red, 2 yellow, 3 green.
        scene: (W,) int32 index into ``scene_names``.
        scene_names: names of the drives or simulation runs.
        map_name: name of the net.
        source: origin of the windows.
        extra: further entries of the file's header.
    """

    map_origin: NDArray[np.float64]
    map_xy: NDArray[np.float32]
    map_features: NDArray[np.float32]
    map_signal: NDArray[np.int32]
    offset: NDArray[np.int64]
    past: NDArray[np.float32]
    past_valid: NDArray[np.bool_]
    future: NDArray[np.float32]
    future_valid: NDArray[np.bool_]
    size: NDArray[np.float32]
    classes: NDArray[np.uint8]
    parked: NDArray[np.bool_]
    near: NDArray[np.int32]
    signals: NDArray[np.uint8]
    scene: NDArray[np.int32]
    scene_names: tuple[str, ...] = ()
    map_name: str = ""
    source: str = ""
    extra: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        problem = _problem(self)
        if problem:
            raise ValueError(f"WindowFile: {problem}")

    @property
    def windows(self) -> int:
        """Number of windows W."""
        return len(self.offset) - 1

    @property
    def agents(self) -> int:
        """Number of agent rows S."""
        return len(self.past)

    def rows(self, window: int) -> slice:
        """Return the agent rows of *window*, the focal agent first."""
        return slice(int(self.offset[window]), int(self.offset[window + 1]))


TENSORS: Mapping[str, tuple[str, tuple[str | int, ...]]] = {
    "map_origin": ("float64", (2,)),
    "map_xy": ("float32", ("M", "N", 2)),
    "map_features": ("float32", ("M", "F")),
    "map_signal": ("int32", ("M",)),
    "offset": ("int64", ("W+1",)),
    "past": ("float32", ("S", PAST, 4)),
    "past_valid": ("bool", ("S", PAST)),
    "future": ("float32", ("S", FUTURE, 4)),
    "future_valid": ("bool", ("S", FUTURE)),
    "size": ("float32", ("S", 2)),
    "classes": ("uint8", ("S",)),
    "parked": ("bool", ("S",)),
    "near": ("int32", ("S", "K")),
    "signals": ("uint8", ("W", "G")),
    "scene": ("int32", ("W",)),
}
"""Type and shape of each tensor; each letter stands for the same number in all shapes."""


def write_windows(path: str | Path, windows: WindowFile) -> None:
    """Write *windows* to *path*; equal windows give equal bytes.

    Raises:
        FileError: the file cannot be written.
    """
    path = Path(path)
    header = {
        **windows.extra,
        "format": FORMAT,
        "source": windows.source,
        "map": windows.map_name,
        "dt_s": str(DT_S),
        "scene_names": json.dumps(list(windows.scene_names)),
    }
    tensors = {name: np.ascontiguousarray(getattr(windows, name)) for name in TENSORS}
    try:
        with whole_file(path) as aside:
            aside.write_bytes(_sorted_header(save(tensors, metadata=header)))
    except OSError as error:
        raise FileError(path, f"cannot be written ({os_reason(error)})", "choose another --out") from None


def read_windows(path: str | Path) -> WindowFile:
    """Return the windows in the file at *path*.

    Raises:
        FileError: the file is missing, truncated or of another format, or its tensors contradict each other.
    """
    path = Path(path)
    header, tensors = _open(path)
    extra = {key: value for key, value in header.items() if key not in _OWN_KEYS}
    try:
        names = tuple(str(name) for name in json.loads(header.get("scene_names", "[]")))
        return WindowFile(
            **tensors,
            scene_names=names,
            map_name=header.get("map", ""),
            source=header.get("source", ""),
            extra=extra,
        )
    except (ValueError, TypeError) as error:
        raise FileError(path, f"holds damaged windows ({error})", _AGAIN) from None


def window_paths(places: list[Path]) -> list[Path]:
    """Return the window files of *places*: files as given, those of a folder sorted by name.

    Raises:
        FileError: a file or folder does not exist, or a folder contains no window file.
    """
    paths: list[Path] = []
    for place in places:
        if place.is_dir():
            files = sorted(p for p in place.glob(f"*{SUFFIX}") if not p.name.startswith("."))
            if not files:
                remedy = "make some with advdiff-sumo data simulate or data build"
                raise FileError(place, f"holds no window file (*{SUFFIX})", remedy)
            paths += files
        elif place.is_file():
            paths.append(place)
        else:
            raise FileError(place, "no such file or folder", "give window files or a folder of them")
    return paths


def _open(path: Path) -> tuple[dict[str, str], dict[str, Any]]:
    try:
        with safe_open(path, framework="numpy") as file:
            header = dict(file.metadata() or {})
            if header.get("format") != FORMAT:
                file_format = header.get("format", "none")
                raise FileError(path, f"is no window file (format '{file_format}', not '{FORMAT}')", _AGAIN)
            missing = sorted(set(TENSORS) - set(file.keys()))
            if missing:
                raise FileError(path, f"lacks the tensors {', '.join(missing)}", _AGAIN)
            return header, {name: file.get_tensor(name) for name in TENSORS}
    except FileNotFoundError:
        raise FileError(path, "no such window file") from None
    except SafetensorError as error:
        raise FileError(path, f"is truncated or no safetensors file ({error})", _AGAIN) from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({os_reason(error)})") from None


def _sorted_header(raw: bytes) -> bytes:
    """Return the file with its JSON header sorted; safetensors writes the metadata in random order."""
    length = int.from_bytes(raw[:8], "little")
    header = json.loads(raw[8 : 8 + length])
    text = json.dumps(header, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + raw[8 + length :]


def _problem(windows: WindowFile) -> str:
    """Return what is wrong with types, shapes, offsets or indices; "" if nothing is."""
    sizes: dict[str, int] = {}
    for name, (dtype, shape) in TENSORS.items():
        value = getattr(windows, name)
        if value.dtype != np.dtype(dtype) or value.ndim != len(shape):
            return f"{name} is {value.dtype} {value.shape}, expected {dtype} {shape}"
        for length, expected in zip(value.shape, shape, strict=True):
            if length != (expected if isinstance(expected, int) else sizes.setdefault(expected, length)):
                return f"{name} has shape {value.shape}, expected {shape} with {sizes}"
    if sizes["W+1"] != sizes["W"] + 1:
        return f"offset has {sizes['W+1']} entries for {sizes['W']} windows"
    return _index_problem(windows, {f.name: getattr(windows, f.name) for f in fields(windows)})


def _index_problem(windows: WindowFile, value: Mapping[str, Any]) -> str:
    offset = windows.offset
    if offset[0] != 0 or offset[-1] != windows.agents or (np.diff(offset) < 1).any():
        return "offset does not divide the agents into windows"
    limits = {"near": len(windows.map_xy), "map_signal": windows.signals.shape[1]}
    for name, limit in limits.items():
        if value[name].size and not (value[name].min() >= -1 and value[name].max() < limit):
            return f"{name} points outside its table of {limit}"
    scenes = windows.scene
    if scenes.size and not (scenes.min() >= 0 and scenes.max() < len(windows.scene_names)):
        return f"scene points outside the {len(windows.scene_names)} scene names"
    if not windows.past_valid[:, -1].all():
        return "an agent is not there now"
    return ""
