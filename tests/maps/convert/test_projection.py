"""Projections of maps."""

from __future__ import annotations

import pyproj
import pytest

from advdiff_sumo.maps.convert.projection import argoverse_projection, projection_of, utm_from


@pytest.mark.parametrize(
    ("city", "xy_m", "place_deg"),  # from the tests of the official API
    [
        ("ATX", (1745.37, -1421.37), (30.261642967615092, -97.72246957081633)),
        ("WDC", (1716.85, 4470.38), (38.9299801515994, -77.0168603173312)),
    ],
)
def test_argoverse_cities(city: str, xy_m: tuple[float, float], place_deg: tuple[float, float]) -> None:
    longitude, latitude = pyproj.Proj(argoverse_projection(city))(*xy_m, inverse=True)
    assert (latitude, longitude) == pytest.approx(place_deg, abs=1e-7)


def test_utm_counted_from_a_place() -> None:
    """Zone 56 in the south, as at the opera in Sydney."""
    east, north = pyproj.Proj("+proj=utm +zone=56 +south +ellps=WGS84")(151.2153, -33.8568)
    shifted = pyproj.Proj(utm_from(56, 334_000.0, 6_252_000.0, south=True))(151.2153, -33.8568)
    assert shifted == pytest.approx((east - 334_000.0, north - 6_252_000.0), abs=1e-3)


def test_nuscenes_places() -> None:
    """A kilometre north of the corner, on the sphere of the devkit."""
    projection = projection_of("boston-seaport")
    assert projection is not None
    longitude, latitude = pyproj.Proj(projection)(0.0, 1000.0, inverse=True)
    assert latitude == pytest.approx(42.336849169438615 + 1000.0 / 6_378_137.0 * 57.29577951308232, abs=1e-9)
    assert longitude == pytest.approx(-71.05785369873047, abs=1e-9)
    assert projection_of("somewhere") is None
