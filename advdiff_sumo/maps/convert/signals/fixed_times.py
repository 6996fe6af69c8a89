"""Set fixed cycles by Webster's formula for random traffic, with SUMO's tool ``tlsCycleAdaptation.py``."""

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
SEED = 1  # of the random traffic


def set_fixed_times(net: Path, vehicles_per_hour: int) -> int:
    """Give the signals of *net* fixed cycles and green times; return the number of signals that were timed by traffic.

    The tool uses one lost time for all phases, here the mean yellow plus all-red time of the net. Yellow and all-red
    times are not changed, nor are the green times of signals without traffic.

    Args:
        net: a net with programs of :func:`.programs.write_programs`, still without pedestrian crossings.
        vehicles_per_hour: amount of traffic, on random trips.

    Raises:
        NetError: SUMO's tools refused the net.
    """
    root = read_root(net, "net", "a SUMO net")
    programs = root.findall("tlLogic")
    if not programs:
        return 0
    with tempfile.TemporaryDirectory() as folder:
        greens = _timed_phases(net, Path(folder), vehicles_per_hour, _lost_s(programs))
    for program in programs:
        _make_static(program, greens.get(program.get("id", ""), []))
    ET.ElementTree(root).write(net, encoding="utf-8", xml_declaration=True)
    return len(greens)


def _lost_s(programs: Sequence[ET.Element]) -> int:
    """Return the mean yellow plus all-red time after a green in whole seconds."""
    phases = [phase for program in programs for phase in program.iterfind("phase")]
    greens = sum("minDur" in phase.attrib for phase in phases)
    changes_s = sum(float(phase.attrib["duration"]) for phase in phases if "minDur" not in phase.attrib)
    return round(changes_s / greens)


def _timed_phases(net: Path, folder: Path, vehicles_per_hour: int, lost_s: int) -> dict[str, list[str]]:
    """Return the durations of all phases in s, as text by signal, as the tool sets them."""
    trips, routes, programs = (folder / name for name in ("trips.xml", "routes.rou.xml", "programs.xml"))
    traffic = {
        "--net-file": net,
        "--output-trip-file": trips,
        "--route-file": routes,
        "--end": HOUR_S,
        "--period": HOUR_S / vehicles_per_hour,
        "--seed": SEED,
    }
    _run_tool(net, "randomTrips.py", traffic)
    times = {
        "--net-file": net,
        "--route-files": routes,
        "--output-file": programs,
        "--begin": 0,
        "--yellow-time": lost_s,
        "--lost-time": lost_s,
        "--min-green": round(SHORTEST_GREEN_S),
        # Shorter phases are not counted as green: in them, links keep green while others are cleared.
        "--green-filter-time": round(LONGEST_ALL_RED_S) + 1,
    }
    _run_tool(net, "tlsCycleAdaptation.py", times)
    timed = read_root(programs, "additional", "an additional file of SUMO").iterfind("tlLogic")
    return {
        program.attrib["id"]: [phase.attrib["duration"] for phase in program.iterfind("phase")]
        for program in timed
    }


def _run_tool(net: Path, tool: str, options: dict[str, object]) -> None:
    """Run a Python tool of SUMO; raise a NetError about *net* if it fails."""
    words = [str(word) for option in options.items() for word in option]
    command = [sys.executable, str(sumo_home() / "tools" / tool), *words]
    result = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    if result.returncode != 0:
        reason = next(
            (line for line in reversed(result.stderr.splitlines()) if line.strip()), "no reason given"
        )
        raise NetError(net, f"SUMO's {tool} failed ({reason.strip()})", "leave out --tls-cycle")


def _make_static(program: ET.Element, durations: Sequence[str]) -> None:
    """Make *program* static, with the green times of *durations* (one per phase); without these, keep its own."""
    program.set("type", "static")
    for number, phase in enumerate(program.findall("phase")):
        if "minDur" in phase.attrib:
            del phase.attrib["minDur"], phase.attrib["maxDur"]
            phase.set("duration", durations[number] if durations else phase.attrib["duration"])
