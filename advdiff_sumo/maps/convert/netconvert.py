"""Run SUMO's netconvert on plain XML, and explain its warnings."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

import sumolib

from advdiff_sumo.core.errors import NetError, os_reason
from advdiff_sumo.core.whole_file import whole_file
from advdiff_sumo.maps.sumo_files import drop_header

PRECISION = "4"  # decimals of coordinates and lengths
TIMEOUT_S = 600  # limit for one run of a SUMO tool
_BUILT = "built.net.xml"  # in a folder of its own: SUMO takes an output with a colon in its path for a host and port


def run_netconvert(
    files: Mapping[str, Path],
    out_net: Path,
    *,
    lefthand: bool,
) -> tuple[str, ...]:
    """Write *out_net* from plain XML and return netconvert's warnings, one per item.

    Args:
        files: plain XML files by netconvert's option name.
        out_net: path of the net to write.
        lefthand: whether traffic keeps left.

    Raises:
        NetError: netconvert refused the plan, or the net cannot be written.
    """
    options = {
        **{name: str(path.absolute()) for name, path in files.items()},
        "output-file": _BUILT,
        "offset.disable-normalization": "true",
        "precision": PRECISION,
        "no-turnarounds": "true",
        "lefthand": "true" if lefthand else "false",
        "aggregate-warnings": "-1",
        "tls.guess": "false",
        "tls.layout": "opposites",
        "tls.default-type": "actuated",
        "junctions.limit-turn-speed": "-1",
        "geometry.max-angle.fix": "false",
        "geometry.min-radius": "0",
        "check-lane-foes.all": "true",
        "output.street-names": "false",
        "xml-validation": "never",
    }
    command = [
        sumolib.checkBinary("netconvert"),
        *(f"--{name}={value}" for name, value in sorted(options.items())),
    ]
    with tempfile.TemporaryDirectory() as folder:
        result = subprocess.run(
            command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False, cwd=folder
        )
        lines = [line.strip() for line in result.stderr.splitlines() if line.strip()]
        built = Path(folder) / _BUILT
        if result.returncode != 0 or not built.exists():
            message = "netconvert refused the plan: " + " ".join(lines[:3])
            raise NetError(out_net, message, "this is a fault of the converter")
        try:
            with whole_file(out_net) as temporary:
                shutil.copyfile(built, temporary)
        except OSError as error:
            raise NetError(
                out_net, f"cannot be written ({os_reason(error)})", "choose another --output"
            ) from None
    drop_header(out_net)
    return tuple(line for line in lines if line.startswith("Warning"))


# Meaning of netconvert's warnings, by a part of their text.
EXPLAINED = {
    "to avoid dead-end": "lane changes are forbidden by a solid divider or on an edge shorter than a car, but a lane "
    "that leads nowhere can only be left by one, so it stays allowed there",
    "is not connected from any incoming edge": "the source has no lane that leads into this one; its neighbours in the "
    "edge have, so it is entered by a lane change",
    "is not connected to outgoing edges": "the source has no way on from there: a map that was clipped ends in it",
    "m short": "a way to or from a return edge beyond the rim was drawn too short and got its length afterwards",
    "Custom shape has distance": "netconvert had moved the end of that lane; its shape was put back afterwards",
    "Intersecting left turns": "the source's centre lines of two opposite turns cross; one of them yields",
    "Ambiguity in turnarounds": "several edges leave a junction nearly opposite to one that enters it; turnarounds "
    "are not built in any case",
    "Minor green from": "a guessed signal lets a turn go that yields to oncoming traffic",
    "Speed of": "a turn is slower than the road before it, as its curvature demands",
}
