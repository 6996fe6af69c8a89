"""On which side of the road one drives, by where the lanes of both directions lie."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.polylines import Polyline
from advdiff_sumo.maps.opposite_lanes import keeps_left, opposite_offsets_m


def line(x0: float, y0: float, x1: float, y1: float) -> Polyline:
    """Return a straight lane of 100 m or so."""
    return Polyline.of(np.array([[x0, y0], [x1, y1]]))


def two_way(y_m: float, side_m: float) -> list[Polyline]:
    """Return an eastbound lane at *y_m* and a westbound one *side_m* to its left."""
    return [line(0.0, y_m, 100.0, y_m), line(100.0, y_m + side_m, 0.0, y_m + side_m)]


def test_distances_by_hand() -> None:
    crossing, same, far = line(50.0, -50.0, 50.0, 50.0), line(0.0, -3.0, 100.0, -3.0), two_way(200.0, 7.0)
    lanes = [*two_way(0.0, 3.5), crossing, same, *far]
    assert opposite_offsets_m(lanes) == pytest.approx([3.5, 3.5, np.nan, np.nan, np.nan, np.nan], nan_ok=True)
    assert opposite_offsets_m([*two_way(0.0, 5.0), *two_way(0.0, -3.0)[1:]])[0] == pytest.approx(
        -3.0
    )  # the nearest
    assert opposite_offsets_m([]).shape == (0,)


@pytest.mark.parametrize(
    ("sides_m", "left"),
    [
        ((3.5, 3.5), False),
        ((-3.5, -3.5), True),
        ((3.5, -3.5), None),  # as many one way as the other
        ((3.5,), None),  # too few to say
        ((3.5, 3.5, 3.5, 3.5, -3.5), False),
        ((0.0, 0.5, -0.5), None),  # on each other
    ],
)
def test_the_side_that_most_lanes_are_on(sides_m: tuple[float, ...], left: bool | None) -> None:
    lanes = [lane for k, side_m in enumerate(sides_m) for lane in two_way(50.0 * k, side_m)]
    assert keeps_left(opposite_offsets_m(lanes)) is left
