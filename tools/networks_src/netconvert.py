"""Run netconvert on a plan, and write a file that depends only on the plan."""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path

import sumolib

from networks_src.corners import LATERAL_MPS2, round_corners
from networks_src.plain import Plan

OPTIONS: tuple[str, ...] = (
    "--no-turnarounds=true",
    "--offset.disable-normalization=true",
    "--default.junctions.radius=8",
    "--junctions.internal-link-detail=20",
    "--junctions.corner-detail=8",
    f"--junctions.limit-turn-speed={LATERAL_MPS2}",
    "--junctions.scurve-stretch=1.0",
    "--rectangular-lane-cut=false",
    "--geometry.max-angle.fix=false",
    "--roundabouts.guess=true",
    "--tls.default-type=static",
    "--tls.layout=opposites",
    "--tls.cycle.time=80",
    "--tls.yellow.min-decel=3",
    "--tls.allred.time=2",
    "--tls.left-green.time=8",
    "--precision=3",
    "--xml-validation=never",
)


def build(plan: Plan, target: Path) -> str:
    """Convert a plan to `target` (.net.xml) in two passes, so that turns can be rounded; return the warnings.

    Raises:
        subprocess.CalledProcessError: netconvert failed.
    """
    with tempfile.TemporaryDirectory() as name:
        raw = Path(name) / "raw.net.xml"
        _convert(plan, Path(name), raw)
        warnings = _convert(round_corners(plan, sumolib.net.readNet(str(raw))), Path(name), raw)
        target.write_text(_scrub(raw.read_text(encoding="utf-8"), plan.name), encoding="utf-8")
    return warnings


def _convert(plan: Plan, folder: Path, raw: Path) -> str:
    files = (f"{option}={path}" for option, path in plan.write(folder).items())
    command = [sumolib.checkBinary("netconvert"), *files, *OPTIONS]
    command += [f"--lefthand={str(plan.lefthand).lower()}", f"--output-file={raw}"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stderr


def _scrub(text: str, name: str) -> str:
    """Replace netconvert's header (date, version, paths) by the call that makes the file."""
    note = f"<!-- Made by: python tools/make_networks.py {name} (SPDX-License-Identifier: Apache-2.0) -->\n\n"
    return re.sub(r"<!--.*?-->\s*", note, text, count=1, flags=re.DOTALL)
