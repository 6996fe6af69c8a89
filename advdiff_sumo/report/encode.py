"""Numbers of an episode as compact text, which the page's script turns back (``page/decode.js``).

A block is a JSON header and whole numbers of 16 bits. Differences of differences of a smooth path are small, so
zigzag codes with low and high bytes apart deflate to about a byte a number. The layout, before zlib and base64:
the header's length in bytes (4, little-endian), the header in UTF-8, the low bytes, the high bytes.
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
#: Code of a value that is not there.
NOTHING = -32768
_GREATEST = 32767


def block(header: Mapping[str, Any], numbers: Sequence[IntArray]) -> str:
    """Return base64 text of *header* and *numbers*, each in [−32768, 32767], one after the other.

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
    """Return whether all *numbers* may stand in a block."""
    return not numbers.size or bool(numbers.min() >= NOTHING and numbers.max() <= _GREATEST)


def second_differences(values: IntArray) -> IntArray:
    """Return the (T − 1,) numbers from which, after the first value, (T,) *values* follow."""
    return np.diff(np.diff(values), prepend=0)


def wrapped_differences(values: FloatArray) -> IntArray:
    """Return (T,) differences modulo 2¹⁶ of *values* in steps of 0.01; NaN has a code of its own."""
    near = np.clip(np.rint(np.nan_to_num(values) * PER_UNIT), -_GREATEST, _GREATEST)
    codes = np.where(np.isfinite(values), near, NOTHING).astype(np.int64)
    return (np.diff(codes, prepend=0) + 32768) % 65536 - 32768


def path_parts(
    xy_m: FloatArray, yaw_rad: FloatArray, origin_m: FloatArray
) -> Iterator[tuple[list[int], list[IntArray]]]:
    """Yield the header and the numbers of each unbroken part of one agent's path.

    Args:
        xy_m: (T, 2); NaN where the agent is absent.
        yaw_rad: (T,).
        origin_m: (2,) what the block's positions are relative to.

    Yields:
        [first instant, instants, first x and y in cm, first heading in 2 mrad], and the second differences.
    """
    for start, stop in _spans(xy_m):
        place = np.rint((xy_m[start:stop] - origin_m) * PER_M).astype(np.int64)
        turn = np.rint(np.unwrap(yaw_rad[start:stop]) * PER_RAD).astype(np.int64)
        x, y = place.T
        yield (
            [start, stop - start, int(x[0]), int(y[0]), int(turn[0])],
            [second_differences(values) for values in (x, y, turn)],
        )


def _spans(xy_m: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield (start, stop) of the stretches without gap and without a jump that 16 bits could not hold."""
    there: BoolArray = np.asarray(np.isfinite(xy_m).all(axis=1))
    far: BoolArray = np.asarray(np.abs(np.diff(xy_m, axis=0)).max(axis=1) > 0.4 * _GREATEST / PER_M)
    begins = there & ~np.concatenate(([False], there[:-1] & ~far))
    starts = np.flatnonzero(begins)
    for start, limit in zip(starts, [*starts[1:], len(there)], strict=True):
        gone = np.flatnonzero(~there[start:limit])
        yield int(start), int(start + gone[0]) if len(gone) else int(limit)
