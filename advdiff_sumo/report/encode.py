"""Encodes the numbers of an episode as compact text, which the page's script decodes (``assets/decode.js``).

A block is a JSON header and integers of 16 bits. Second differences of a smooth path are small: zigzag codes with
separate low and high bytes are compressed to about one byte per number. The layout, before zlib and base64: the
header's length in bytes (4, little-endian), the header in UTF-8, the low bytes, the high bytes.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray

#: Positions are whole multiples of 1 cm, headings of 2 mrad, values of charts of 0.01.
PER_M, PER_RAD, PER_UNIT = 100.0, 500.0, 100.0
#: Code of a missing value.
NOTHING = -32768
_GREATEST = 32767


def block(header: Mapping[str, Any], numbers: Sequence[IntArray]) -> str:
    """Return base64 text of *header* and the concatenated *numbers*, each in [−32768, 32767].

    Raises:
        ValueError: a number is out of range.
    """
    joined = np.concatenate([np.zeros(0, dtype=np.int64), *numbers])
    if not fits(joined):
        raise ValueError("a number does not fit 16 bits")
    codes = np.where(joined < 0, -2 * joined - 1, 2 * joined).astype("<u2")
    low, high = (codes & 0xFF).astype(np.uint8), (codes >> 8).astype(np.uint8)
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
    raw = len(text).to_bytes(4, "little") + text + low.tobytes() + high.tobytes()
    return base64.b64encode(zlib.compress(raw, 9)).decode("ascii")


def fits(numbers: IntArray) -> bool:
    """Return whether all *numbers* are in the range of a block."""
    return not numbers.size or bool(numbers.min() >= NOTHING and numbers.max() <= _GREATEST)


def second_differences(values: IntArray) -> IntArray:
    """Return (T − 1,) numbers from which *values* (T,) can be restored if the first value is known."""
    return np.diff(np.diff(values), prepend=0)


def wrapped_differences(values: FloatArray) -> IntArray:
    """Return the differences (T,) modulo 2¹⁶ of *values* in steps of 0.01; NaN counts as ``NOTHING``."""
    rounded = np.clip(np.rint(np.nan_to_num(values) * PER_UNIT), -_GREATEST, _GREATEST)
    codes = np.where(np.isfinite(values), rounded, NOTHING).astype(np.int64)
    return (np.diff(codes, prepend=0) + 32768) % 65536 - 32768


def path_parts(
    xy_m: FloatArray, yaw_rad: FloatArray, origin_m: FloatArray
) -> Iterator[tuple[list[int], list[IntArray]]]:
    """Yield the header and the numbers of each unbroken part of one agent's path.

    Args:
        xy_m: (T, 2); NaN where the agent is absent.
        yaw_rad: (T,).
        origin_m: (2,) origin of the block's positions.

    Yields:
        [first instant, number of instants, first x and y in cm, first heading in 2 mrad], and the second differences
        of x, y and heading.
    """
    for start, stop in _continuous_spans(xy_m):
        xy_cm = np.rint((xy_m[start:stop] - origin_m) * PER_M).astype(np.int64)
        yaw_steps = np.rint(np.unwrap(yaw_rad[start:stop]) * PER_RAD).astype(np.int64)
        x, y = xy_cm.T
        yield (
            [start, stop - start, int(x[0]), int(y[0]), int(yaw_steps[0])],
            [second_differences(values) for values in (x, y, yaw_steps)],
        )


def _continuous_spans(xy_m: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield (start, stop) of the spans without absence and without a jump that exceeds 16 bits."""
    is_present: BoolArray = np.asarray(np.isfinite(xy_m).all(axis=1))
    has_jump: BoolArray = np.asarray(np.abs(np.diff(xy_m, axis=0)).max(axis=1) > 0.4 * _GREATEST / PER_M)
    is_start = is_present & ~np.concatenate(([False], is_present[:-1] & ~has_jump))
    starts = np.flatnonzero(is_start)
    for start, limit in zip(starts, [*starts[1:], len(is_present)], strict=True):
        absent_steps = np.flatnonzero(~is_present[start:limit])
        yield int(start), int(start + absent_steps[0]) if len(absent_steps) else int(limit)
