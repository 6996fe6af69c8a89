"""Where on the globe the nuScenes maps lie."""

from __future__ import annotations

ORIGINS_DEG = {  # south-west corner, latitude and longitude
    "boston-seaport": (42.336849169438615, -71.05785369873047),
    "singapore-onenorth": (1.2882100868743724, 103.78475189208984),
    "singapore-hollandvillage": (1.2993652317780957, 103.78217697143555),
    "singapore-queenstown": (1.2782562240223188, 103.76741409301758),
}


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
