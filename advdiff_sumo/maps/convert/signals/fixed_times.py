"""Fixed cycles after Webster's formula, set by SUMO's own tool ``tlsCycleAdaptation.py`` for random traffic."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.maps.convert.netconvert import TIMEOUT_S
from advdiff_sumo.maps.convert.signals.programs import SHORTEST_GREEN_S
from advdiff_sumo.maps.read_net import read_root
from advdiff_sumo.maps.signal_times import LONGEST_ALL_RED_S
from advdiff_sumo.maps.sumo_files import sumo_home

HOUR_S = 3600.0
SEED = 1


def set_fixed_times(net: Path, vehicles_per_hour: int) -> int:
    """Give the signals of *net* fixed cycles and greens; return how many have traffic to be timed by.

    The tool takes one lost time for all phases: the mean yellow and all-red of the net. Yellow and all-red themselves
    stay as they are, and so do the greens of signals without traffic.

    Args:
        net: with programs of :func:`.programs.write_programs` and no crossings on foot yet.
        vehicles_per_hour: on random trips, for which the times are set.

    Raises:
        NetError: SUMO's tools refused the net.
    """
    root = read_root(net, "net", "a SUMO net")
    programs = root.findall("tlLogic")
    if not programs:
        return 0
    with tempfile.TemporaryDirectory() as folder:
        greens = _greens(net, Path(folder), vehicles_per_hour, _lost_s(programs))
    for program in programs:
        _fix(program, greens.get(program.get("id", ""), []))
    ET.ElementTree(root).write(net, encoding="utf-8", xml_declaration=True)
    return len(greens)


def _lost_s(programs: Sequence[ET.Element]) -> int:
    """Return the mean yellow and all-red after a green in whole seconds."""
    phases = [phase for program in programs for phase in program.iterfind("phase")]
    greens = sum("minDur" in phase.attrib for phase in phases)
    changes_s = sum(float(phase.attrib["duration"]) for phase in phases if "minDur" not in phase.attrib)
    return round(changes_s / greens)


def _greens(net: Path, folder: Path, vehicles_per_hour: int, lost_s: int) -> dict[str, list[str]]:
    """Return the durations of all phases by signal, as the tool sets them."""
    trips, routes, programs = (folder / name for name in ("trips.xml", "routes.rou.xml", "programs.xml"))
    traffic = {
        "--net-file": net,
        "--output-trip-file": trips,
        "--route-file": routes,
        "--end": HOUR_S,
        "--period": HOUR_S / vehicles_per_hour,
        "--seed": SEED,
    }
    _run(net, "randomTrips.py", traffic)
    times = {
        "--net-file": net,
        "--route-files": routes,
        "--output-file": programs,
        "--begin": 0,
        "--yellow-time": lost_s,
        "--lost-time": lost_s,
        "--min-green": round(SHORTEST_GREEN_S),
        "--green-filter-time": round(LONGEST_ALL_RED_S) + 1,  # greens that go on while others get clear
    }
    _run(net, "tlsCycleAdaptation.py", times)
    timed = read_root(programs, "additional", "an additional file of SUMO").iterfind("tlLogic")
    return {
        program.attrib["id"]: [phase.attrib["duration"] for phase in program.iterfind("phase")]
        for program in timed
    }


def _run(net: Path, tool: str, options: dict[str, object]) -> None:
    words = [str(word) for option in options.items() for word in option]
    command = [sys.executable, str(sumo_home() / "tools" / tool), *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    if done.returncode != 0:
        reason = next(
            (line for line in reversed(done.stderr.splitlines()) if line.strip()), "no reason given"
        )
        raise NetError(net, f"SUMO's {tool} failed ({reason.strip()})", "leave out --tls-cycle")


def _fix(program: ET.Element, durations: Sequence[str]) -> None:
    """Take the greens of *durations*, one for each phase, into *program*, and make it static."""
    program.set("type", "static")
    for number, phase in enumerate(program.findall("phase")):
        if "minDur" in phase.attrib:
            del phase.attrib["minDur"], phase.attrib["maxDur"]
            phase.set("duration", durations[number] if durations else phase.attrib["duration"])
