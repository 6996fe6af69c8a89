"""Writes ``report.html``: one file, no network, the same bytes for the same run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import FileError, os_reason
from advdiff_sumo.core.whole_file import whole_file
from advdiff_sumo.metrics.archive import MANOEUVRES
from advdiff_sumo.metrics.severity import badge, worst_first
from advdiff_sumo.planners.remote.remote_name import is_remote
from advdiff_sumo.report.blocks import streets_block
from advdiff_sumo.report.folder import FinishedRun
from advdiff_sumo.report.histograms import histograms
from advdiff_sumo.report.labels import Labels, run_title
from advdiff_sumo.report.margin_pairs import margins_of
from advdiff_sumo.report.margin_table import read_command
from advdiff_sumo.report.matrix import archives_of, matrix_of, situations_of
from advdiff_sumo.report.nets import NetLayers, place_names
from advdiff_sumo.report.overview import Overview, overview_of
from advdiff_sumo.report.rate_blocks import headline
from advdiff_sumo.report.reference_episodes import ReferenceEpisodes
from advdiff_sumo.report.sample_pictures import samples_by_background
from advdiff_sumo.report.sections import Section, Sections
from advdiff_sumo.report.templates import breaches_of, templates

#: Number of nets that get a map, those with the most collisions first.
MOST_MAPS = 6


def write_report(folder: Path) -> Path:
    """Write ``report.html`` into the folder of a finished or interrupted run or sweep and return its path.

    Raises:
        FileError: a file of the run is missing or damaged, or the report cannot be written.
    """
    path = folder / "report.html"
    content = report_html(FinishedRun.read(folder)).encode()
    try:
        with whole_file(path) as temporary:
            temporary.write_bytes(content)
    except OSError as error:
        raise FileError(path, f"cannot be written ({os_reason(error)})", "make the folder writable") from None
    return path


def report_html(run: FinishedRun) -> str:
    """Return the page of *run*."""
    labels, nets, natural_episodes = Labels(run.episodes), NetLayers(run), ReferenceEpisodes(run)
    ordered = worst_first(run.episodes)
    nets_in_order = list(dict.fromkeys(str(row["net"]) for row in ordered))
    sections = list(Sections(run, nets, natural_episodes, labels, nets_in_order).make(ordered))
    names = place_names(nets_in_order)
    maps = _maps(run, nets, sections, names)
    streets = _streets(nets, nets_in_order, sections)
    return (
        templates()
        .get_template("page.html")
        .render(
            run=run,
            name=run.folder.resolve().name,
            own=own_modules(run.options, *run.episodes),
            labels=labels,
            targets=sorted({labels.target(row) for row in run.episodes}),
            backgrounds=sorted({labels.background(row) for row in run.episodes}),
            places=list(names.values()),
            verdicts=list(dict.fromkeys(badge(row) for row in ordered)),
            breaches=sorted({name for row in run.episodes for name in breaches_of(row)}),
            kinds=sorted({str(row["collision_type"]) for row in run.episodes if row["collision_type"]}),
            settings=list(_flat(run.settings)),
            rates=headline(run.episodes, run.unstarted),
            title=run_title(labels, run),
            margins=margins_of(run, nets),
            again=read_command(run.folder),
            archives=archives_of(run.episodes, labels),
            manoeuvres=MANOEUVRES,
            matrix=matrix_of(run.episodes, labels),
            situations=situations_of(run.episodes, labels),
            histograms=histograms(samples_by_background(run, natural_episodes, labels)),
            maps=maps,
            problems=[nets.problems[net] for net in sorted(nets.problems)],
            episodes=ordered,
            pictures=[s.html for s in sections if s.html],
            pictured={s.episode for s in sections if s.html},
            played={s.episode for s in sections if s.block},
            left_out=sum(s.left_out for s in sections),
            blocks=[(f"e{s.episode}", s.block) for s in sections if s.block] + streets,
            index=[s.facts for s in sections if s.block],
        )
    )


def own_modules(*options: Mapping[str, Any]) -> list[str]:
    """Return the files, or the folders of packages, of users' own targets and backgrounds, which a repetition imports.

    Args:
        options: of a run, or rows of a sweep's ``episodes``; their "target" and "background" are examined.
    """
    names = (str(named.get(plug_in) or "") for named in options for plug_in in ("target", "background"))
    modules = (name.partition(":")[0].partition(".") for name in names if ":" in name and not is_remote(name))
    files = (
        f"{top}/" if inner else f"{top}.py"
        for top, _, inner in modules
        if top not in ("advdiff_sumo", "__main__")
    )
    return list(dict.fromkeys(files))


def _trails(sections: list[Section]) -> dict[str, list[FloatArray]]:
    """Return net → paths of the target in the episodes with a picture or in the player."""
    trails: dict[str, list[FloatArray]] = {}
    for section in sections:
        if section.html or section.block:
            trails.setdefault(section.net, []).append(section.target_xy_m)
    return trails


def _maps(
    run: FinishedRun, nets: NetLayers, sections: list[Section], names: Mapping[str, str]
) -> list[Overview]:
    """Return the maps of the nets, titled by *names*, those with the most collisions first."""
    trails = _trails(sections)
    rows = {net: [row for row in run.episodes if row["net"] == net] for net in trails}
    by_collisions = sorted(
        trails, key=lambda net: (-sum(bool(r["target_collision"]) for r in rows[net]), net)
    )
    return [
        overview_of(names[net], nets.layer(net), trails[net], rows[net]) for net in by_collisions[:MOST_MAPS]
    ]


def _streets(nets: NetLayers, net_names: list[str], sections: list[Section]) -> list[tuple[str, str]]:
    """Return (id, block) of the streets of each net that has an episode in the player."""
    streets = []
    for number, net in enumerate(net_names):
        paths = [s.target_xy_m for s in sections if s.block and s.net == net]
        layer = nets.layer(net)
        if paths and layer is not None:
            streets.append((f"net-{number}", streets_block(layer, paths)))
    return streets


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield (dotted name, value as text) of nested tables."""
    for key, value in settings.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        else:
            yield name, str(value).lower() if isinstance(value, bool) else str(value)
