"""Where on the globe the nuScenes maps lie."""

from __future__ import annotations

import pyproj

ORIGINS_DEG = {  # south-west corner, latitude and longitude
    "boston-seaport": (42.336849169438615, -71.05785369873047),
    "singapore-onenorth": (1.2882100868743724, 103.78475189208984),
    "singapore-hollandvillage": (1.2993652317780957, 103.78217697143555),
    "singapore-queenstown": (1.2782562240223188, 103.76741409301758),
}


ARGOVERSE_CITIES = {  # UTM zone (all north), and latitude and longitude of the origin of the city's coordinates
    "ATX": (14, 30.27464237939507, -97.7404457407424),
    "DTW": (17, 42.29993066912924, -83.17555750783717),
    "MIA": (17, 25.77452579915163, -80.19656914449405),
    "PAO": (10, 37.416065, -122.13571963362166),
    "PIT": (17, 40.44177902989321, -80.01294377242584),
    "WDC": (18, 38.889377, -77.0355047439081),
}


def argoverse_projection(city: str) -> str:
    """Return the PROJ string whose plane is the frame of an Argoverse 2 city: UTM, counted from the city's origin.

    The origins are those of ``av2.geometry.utm`` of the official API.
    """
    zone, latitude, longitude = ARGOVERSE_CITIES[city]
    east, north = pyproj.Proj(f"+proj=utm +zone={zone} +ellps=WGS84")(longitude, latitude)
    return utm_from(zone, east, north)


def utm_from(zone: int, east_m: float, north_m: float, *, south: bool = False) -> str:
    """Return the PROJ string of a UTM zone with coordinates counted from a place in it."""
    return (
        f"+proj=tmerc +lat_0=0 +lon_0={6 * zone - 183} +k=0.9996 +x_0={500_000.0 - east_m:.4f} "
        f"+y_0={(10_000_000.0 if south else 0.0) - north_m:.4f} +ellps=WGS84 +units=m +no_defs"
    )


def projection_of(location: str) -> str | None:
    """Return the PROJ string whose plane is the frame of *location*, or None for an unknown place.

    An azimuthal equidistant projection on a sphere of the equatorial radius is what the nuScenes devkit's own
    latitudes and longitudes follow.
    """
    origin = ORIGINS_DEG.get(location)
    return (
        f"+proj=aeqd +lat_0={origin[0]} +lon_0={origin[1]} +R=6378137 +units=m +no_defs" if origin else None
    )


def drives_left(location: str) -> bool:
    """Return whether traffic keeps left there (Singapore)."""
    return location.startswith("singapore")
