"""Projections of maps: PROJ strings whose plane is the frame of a map."""

from __future__ import annotations

import warnings

import pyproj
from pyproj.exceptions import CRSError

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
    """Return the PROJ string whose plane is the frame of an Argoverse 2 city: UTM relative to the city's origin.

    The origins are those of ``av2.geometry.utm`` of the official API.
    """
    zone, latitude, longitude = ARGOVERSE_CITIES[city]
    east, north = pyproj.Proj(f"+proj=utm +zone={zone} +ellps=WGS84")(longitude, latitude)
    return utm_from(zone, east, north)


def utm_from(zone: int, east_m: float, north_m: float, *, south: bool = False) -> str:
    """Return the PROJ string of a UTM zone whose coordinates are relative to the point (*east_m*, *north_m*)."""
    return (
        f"+proj=tmerc +lat_0=0 +lon_0={6 * zone - 183} +k=0.9996 +x_0={500_000.0 - east_m:.4f} "
        f"+y_0={(10_000_000.0 if south else 0.0) - north_m:.4f} +ellps=WGS84 +units=m +no_defs"
    )


def projection_from(system: str, offset_m: tuple[float, float] = (0.0, 0.0)) -> str:
    """Return the PROJ string of a projected *system* whose coordinates are relative to *offset_m*.

    Args:
        system: PROJ string, WKT or code of an authority ("EPSG:32611"); its heights are ignored.
        offset_m: vector from coordinates of the map to coordinates of the system: system = map + offset.

    Raises:
        ValueError: PROJ does not know the system, or it has no plane in metres; the message says which.
    """
    try:
        # pyproj warns that PROJ strings hold less than WKT, but SUMO reads nothing else.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            crs = pyproj.CRS.from_user_input(system.strip())
            crs = crs.sub_crs_list[0] if crs.is_compound else crs
            words = str(crs.to_proj4()).split()
    except CRSError:
        raise ValueError("is no coordinate system that PROJ knows") from None
    if not crs.is_projected:
        raise ValueError("is no projected coordinate system")
    if any(axis.unit_conversion_factor != 1.0 for axis in crs.axis_info[:2]):
        raise ValueError("is no coordinate system in metres")
    values = {key: value for key, _, value in (word.partition("=") for word in words) if key != "+type"}
    if any(offset_m):
        values = _shifted(offset_m, values)
    return " ".join(f"{key}={value}" if value else key for key, value in values.items())


def _shifted(offset_m: tuple[float, float], values: dict[str, str]) -> dict[str, str]:
    """Return the parameters of a projection whose coordinates are smaller by *offset_m*."""
    if values["+proj"] == "utm":  # "utm" accepts no false easting and northing, so it becomes "tmerc"
        utm = {"+lat_0": "0", "+lon_0": str(6 * int(values.pop("+zone")) - 183), "+k": "0.9996"}
        utm |= {"+x_0": "500000", "+y_0": "10000000" if "+south" in values else "0"}
        other_values = {key: value for key, value in values.items() if key not in ("+proj", "+south")}
        values = {"+proj": "tmerc"} | utm | other_values
    x_m, y_m = (
        float(values.get(key, 0.0)) - metres for key, metres in zip(("+x_0", "+y_0"), offset_m, strict=True)
    )
    return values | {"+x_0": f"{x_m:.4f}", "+y_0": f"{y_m:.4f}"}


def projection_of(location: str) -> str | None:
    """Return the PROJ string whose plane is the frame of a nuScenes *location*, or None for an unknown one.

    The latitudes and longitudes of the nuScenes devkit follow an azimuthal equidistant projection on a sphere of the
    equatorial radius.
    """
    origin = ORIGINS_DEG.get(location)
    return (
        f"+proj=aeqd +lat_0={origin[0]} +lon_0={origin[1]} +R=6378137 +units=m +no_defs" if origin else None
    )


def drives_left(location: str) -> bool:
    """Return whether traffic keeps left at *location*: in Singapore, as nuScenes and nuPlan name its places."""
    return location.startswith(("singapore", "sg-"))
