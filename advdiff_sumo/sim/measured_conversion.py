"""Convert an HD map, measure how exact the net is, and drive over it: all that ``convert`` does for one map."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from advdiff_sumo.config import Options
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.maps.convert import ConversionResult, convert_source
from advdiff_sumo.maps.convert.convert import Crossings
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.fidelity_report import fidelity_path, write_figures, write_page
from advdiff_sumo.maps.convert.poses import compare_poses, ego_poses
from advdiff_sumo.maps.not_a_net import map_name
from advdiff_sumo.sim.source_maps import read_source


class ConvertOptions(Options):
    """Options of the conversion; the command has the same names, such as ``--tls`` for ``tls``.

    Attributes:
        lefthand: whether traffic keeps left; None: decided by the map's name.
        tls: "map": signals only where the map has them; "guess": also at large junctions.
        tls_cycle: fixed signal times for this number of vehicles an hour; 0: actuated.
        crossings: "map": those of the map; "guess": guessed ones if it has none; "none".
        opendrive: write NAME.xodr too.
        close_rim: lead traffic back from where the map ends to where it begins.
        osm: OpenStreetMap extract whose streets continue those that end at the map's rim.
        dataroot: nuScenes data set whose logged poses are compared with the net.
        report: write the page NAME.fidelity.html; without it, the page of an earlier net is deleted.
        drive: driving test of an hour in which this number of vehicles departs; 0: none.
        drive_at_once: driving test of an hour with this number of vehicles at any time; 0: none.
        seed: of the driving tests.
    """

    lefthand: bool | None = None
    tls: Literal["map", "guess"] = "map"
    tls_cycle: int = Field(0, ge=0)
    crossings: Crossings = "map"
    opendrive: bool = False
    close_rim: bool = False
    osm: Path | None = None
    dataroot: Path | None = None
    report: bool = False
    drive: int = Field(0, ge=0)
    drive_at_once: int = Field(0, ge=0)
    seed: int = 1


@dataclass(frozen=True, eq=False)
class MeasuredConversion:
    """A net made from an HD map, and how exact it is.

    Attributes:
        result: what the conversion made.
        figures: content of NAME.fidelity.json.
    """

    result: ConversionResult
    figures: dict[str, Any]

    @property
    def net(self) -> Path:
        """The SUMO net."""
        return self.result.net

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each thing that was left out or repaired and that a user should know."""
        return self.result.source.warnings


def convert_and_measure(map_file: Path, net: str | Path, options: ConvertOptions) -> MeasuredConversion:
    """Convert *map_file* to *net*, write NAME.fidelity.json beside it, and whatever else *options* request.

    Args:
        map_file: of any kind that the command accepts.
        net: NAME.net.xml; NAME and NAME.xml mean the same; for a folder, or FOLDER/, the net in it is named after
            the map.
        options: of the conversion and the measurements.

    Raises:
        InputError: one of its kinds; the message names the culprit.
        SimulationError: SUMO stopped in a driving test.
    """
    net = _net_path(net, map_file)
    result = convert_source(
        read_source(map_file),
        net,
        lefthand=options.lefthand,
        guess_signals=options.tls == "guess",
        opendrive=options.opendrive,
        close_rim=options.close_rim,
        osm=options.osm,
        crossings=options.crossings,
        cycle_for=options.tls_cycle,
    )
    figures = _accuracy(result, options.dataroot)
    write_figures(figures, fidelity_path(net))  # these remain if the driving test fails
    figures |= _driving_tests(net, options)
    write_figures(figures, fidelity_path(net))
    page = fidelity_path(net, "html")
    if options.report:
        write_page(result, figures, page)
    else:
        page.unlink(missing_ok=True)  # of an earlier conversion
    return MeasuredConversion(result, figures)


def _net_path(requested: str | Path, map_file: Path) -> Path:
    """Return *requested* with the ending of SUMO nets.

    Raises:
        ConfigError: it has the ending of other files.
    """
    output = Path(requested)
    if output.is_dir() or str(requested).endswith(("/", os.sep)):
        return output / f"{map_name(map_file)}.net.xml"
    if output.name.endswith(".net.xml"):
        return output
    if output.suffix != ".xml" and output.suffix[1:].isalpha():  # a name may end in a version number
        raise ConfigError(
            f"{output}: a net is NAME.net.xml; give that, or NAME alone, in place of {output.suffix}"
        )
    return output.with_name(output.name.removesuffix(".xml") + ".net.xml")


def _accuracy(result: ConversionResult, dataroot: Path | None) -> dict[str, Any]:
    """Return figures on how exact the net is; with *dataroot*, also by the poses logged there."""
    figures: dict[str, Any] = measure(result).as_dict()
    if dataroot is not None:
        poses = ego_poses(dataroot, result.source.location)
        figures["logged_poses"] = compare_poses(
            result, np.vstack(list(poses.values())) if poses else np.empty((0, 3))
        )
    return figures


def _driving_tests(net: Path, options: ConvertOptions) -> dict[str, Any]:
    """Return the results of the driving tests for which *options* give a number of vehicles."""
    if not (options.drive or options.drive_at_once):
        return {}
    from advdiff_sumo.sim.driving_test import driving_test  # late: SUMO is slow to import

    figures: dict[str, Any] = {}
    if options.drive:
        figures["driving_test_in_the_hour"] = driving_test(net, vehicles=options.drive, seed=options.seed)
    if options.drive_at_once:
        figures["driving_test_at_once"] = driving_test(
            net, vehicles=options.drive_at_once, at_once=True, seed=options.seed
        )
    return figures
