"""``advdiff-sumo convert``: convert an HD map into a SUMO net."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.wording import counted

if TYPE_CHECKING:
    from advdiff_sumo.sim.measured_conversion import MeasuredConversion

MAP_HELP = (
    "nuScenes or Argoverse 2 map (.json), ScenarioNet record (.pkl), CommonRoad scenario (.xml, .xml.gz), Lanelet2 "
    "(.osm), OpenDRIVE (.xodr) or nuPlan map (.gpkg)."
)
_console = terminal(highlight=False, soft_wrap=True)


_Output = Annotated[
    str | None,
    typer.Option(
        "--out",
        "--output",
        "-o",
        metavar="PATH",
        help="Net to be written, NAME.net.xml, or its folder; with --all: a folder.",
    ),
]
_Lefthand = Annotated[
    bool | None,
    typer.Option(
        "--lefthand/--righthand", help="Side of the road; default: by the map's name, or by its lanes."
    ),
]
_Tls = Annotated[
    str, typer.Option(help="'guess': signals at large junctions; 'map': only where the map has them.")
]
_TlsCycle = Annotated[
    int,
    typer.Option(
        min=0,
        metavar="N",
        help="Fixed signal times, for N random vehicles an hour, by tlsCycleAdaptation of SUMO; 0: actuated.",
    ),
]
_CrossingsOption = Annotated[
    str,
    typer.Option(
        help="Crossings and sidewalks: 'map': where the map has crossings; 'guess': at junctions too where it has "
        "none at all; 'none'."
    ),
]
_CloseRim = Annotated[
    bool, typer.Option("--close-rim", help="Lead traffic back from where the map ends to where it begins.")
]
_Osm = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="OpenStreetMap extract of the same place, whose streets lead on where the map ends, and back to it.",
    ),
]
_Drive = Annotated[int, typer.Option(min=0, help="Driving test of an hour with N vehicles in all; 0: none.")]
_DriveAtOnce = Annotated[
    int, typer.Option(min=0, help="Driving test of an hour with N vehicles at any time; 0: none.")
]


def convert(
    map_file: Annotated[Path | None, typer.Argument(metavar="MAP", help=MAP_HELP)] = None,
    output: _Output = None,
    all_of: Annotated[
        Path | None,
        typer.Option("--all", metavar="DATAROOT", help="Convert every map of a nuScenes data set."),
    ] = None,
    dataroot: Annotated[
        Path | None, typer.Option(help="nuScenes data set whose logged poses are compared with the net.")
    ] = None,
    report: Annotated[bool, typer.Option(help="Write the page NAME.fidelity.html")] = False,
    lefthand: _Lefthand = None,
    tls: _Tls = "map",
    tls_cycle: _TlsCycle = 0,
    crossings: _CrossingsOption = "map",
    opendrive: Annotated[bool, typer.Option(help="Write NAME.xodr too.")] = False,
    close_rim: _CloseRim = False,
    osm: _Osm = None,
    drive: _Drive = 0,
    drive_at_once: _DriveAtOnce = 0,
    seed: Annotated[int, typer.Option(help="Seed of the driving tests.")] = 1,
) -> None:
    """Convert HD maps to SUMO nets with exact centre lines, and measure how exact they are.

    Example: advdiff-sumo convert boston-seaport.json -o networks/boston-seaport.net.xml --report
    """
    from advdiff_sumo.sim.measured_conversion import (  # late: --help needs neither SUMO nor plots
        ConvertOptions,
        convert_and_measure,
    )

    if osm is not None and all_of is not None:
        raise ConfigError("--osm is an extract of one place: give it with one MAP, not with --all")
    values = {
        "lefthand": lefthand,
        "tls": tls,
        "tls_cycle": tls_cycle,
        "crossings": crossings,
        "opendrive": opendrive,
        "close_rim": close_rim,
        "osm": osm,
        "dataroot": dataroot or all_of,
        "report": report,
        "drive": drive,
        "drive_at_once": drive_at_once,
        "seed": seed,
    }
    for name, word in (("tls", tls), ("crossings", crossings)):
        _check_word(f"--{name}", word, get_args(ConvertOptions.model_fields[name].annotation))
    options = ConvertOptions.parse(values, "convert")
    for source, net in _jobs(map_file, output, all_of):
        _print_conversion(convert_and_measure(source, net, options), report)


def _check_word(option: str, word: str, known: Sequence[str]) -> None:
    """Raise ConfigError unless *word*, the value of *option*, is one of *known*."""
    *others, last = map(repr, known)
    if word not in known:
        raise ConfigError(f"{option} {word}: known are {', '.join(others)} and {last}")


def _jobs(map_file: Path | None, output: str | None, all_of: Path | None) -> list[tuple[Path, str | Path]]:
    """Return the (map, net) pairs to convert.

    Raises:
        ConfigError: neither or both of a map and ``--all`` are given, the net has no name, or there are no maps.
    """
    if (map_file is None) == (all_of is None):
        raise ConfigError("give either one MAP or --all DATAROOT")
    if map_file is not None:
        if output is None:
            raise ConfigError("give the net to be written with -o NAME.net.xml")
        return [(map_file, output)]
    assert all_of is not None  # noqa: S101 - either the map or --all is given
    maps = sorted((all_of / "maps" / "expansion").glob("*.json"))
    if not maps:
        raise ConfigError(f"{all_of} holds no maps/expansion/*.json; unpack the map expansion v1.3 there")
    folder = Path(output or "networks")
    return [(path, folder / f"{path.stem}.net.xml") for path in maps]


def _print_conversion(converted: MeasuredConversion, report: bool) -> None:
    """Print how exact a net is, its notes and, with *report*, the path of the fidelity report."""
    result, figures = converted.result, converted.figures
    error = figures["centre_line_error_m"]["source_to_net"]
    lanes, links = figures["lanes"], figures["connections"]
    _console.print(
        f"{result.net}: {lanes['edge_lanes']} lanes in {lanes['edges']} edges hold {lanes['held']} of "
        f"{lanes['given']} lanes and connectors of the file and {_links_held(links)}, "
        f"centre lines of these off by {error['median']} m (median), "
        f"{error['max']} m (largest), {counted(len(figures['netconvert_warnings']), 'kind')} of netconvert warnings"
    )
    if result.streets is not None:
        _print_streets(figures["streets_beyond_the_rim"], figures["routability"])
    paths = result.foot_paths
    if paths is not None and paths.given:
        _console.print(
            f"{paths.kept} of {paths.given} {'guessed ' if paths.guessed else ''}crossings are in the net, "
            f"with {paths.sidewalk_m / 1000.0:.1f} km of sidewalks"
        )
        for reason, places in sorted(paths.left_out.items()):
            _console.print(f"note: {len(places)} of the crossings left out: {reason}")
    for sentence in converted.warnings:
        _console.print(f"note: {sentence}")
    if report:
        from advdiff_sumo.maps.convert.fidelity_report import fidelity_path  # late: --help needs no plots

        _console.print(f"look at {fidelity_path(result.net, 'html')}", soft_wrap=True)


def _links_held(links: dict[str, Any]) -> str:
    """Return how many links a net holds; if the file states none, links are made where lanes meet."""
    if not links["given"]:
        return f"{counted(links['repaired'], 'link')} where lanes meet (it states none)"
    return f"{links['kept']} of its {links['given']} links ({links['repaired']} repaired)"


def _print_streets(streets: dict[str, Any], routability: dict[str, Any]) -> None:
    """Print how many streets of the OpenStreetMap extract continue the map, and how routable it is with them."""
    if not streets["streets"]:
        _console.print(
            "note: no street of --osm leads from an end of the map back to it; the net has none of them"
        )
        return
    before = streets["largest_part_share_of_length_without"]
    after = routability["largest_part_share_of_length"]
    _console.print(
        f"{streets['streets']} streets of {streets['km']} km lead on from {streets['edges_that_lead_into_streets']} "
        f"edges and back to {streets['edges_that_streets_lead_into']}, {streets['ends_without_street']} ends have "
        f"none: {after:.0%} of the map's length is strongly connected, {before:.0%} without them"
    )
