"""Plans the cells of ``bench defects``: sound target, careful driver and each defect, with each background."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from advdiff_sumo.experiments.bench.bench_config import Folder, Request
from advdiff_sumo.experiments.bench.bench_rows import (
    PAPERS_LICENCE,
    REGISTERED,
    made_background,
    made_target,
    policy_row,
    resolve_request,
    with_licence,
)
from advdiff_sumo.experiments.bench.cells import BenchCell, BenchCells, plan_cells
from advdiff_sumo.experiments.bench.detection import too_few_scenes
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.scene_list import DEFECTS_LIST, SceneList
from advdiff_sumo.planners.defects import DEFECTS, Defect, parse_defects
from advdiff_sumo.planners.planner_protocol import SumoDriver
from advdiff_sumo.planners.planner_registry import TARGETS

SOUND, CAREFUL = "sound", "careful"
_DEFAULT_TARGET = "lane_graph"
_BACKGROUNDS = {name: background for name, background in REGISTERED.items() if name != "traj2traj"} | {
    "scripted": "scripted"
}


def plan_defects(folder: Folder, reporter: ProgressReporter) -> BenchCells:
    """Return the cells of the request, one background after the other.

    Raises:
        InputError: a name is unknown, or the list of scenes cannot be used.
    """
    request = folder.request
    scenes, targets, names = resolve_defects_request(request, reporter, folder.path)
    defects_by_target = {target: planted_defects(target, request, reporter) for target in targets}
    for target, defects in defects_by_target.items():
        if warning := too_few_scenes(len(scenes.scenes), target, len(defects)):
            reporter.say(warning)
    cells = []
    for name in names:
        if CAREFUL in TARGETS.names() and CAREFUL not in targets:
            cells.append(_cell(request, name, CAREFUL))
        for target, defects in defects_by_target.items():
            target_options = request.episode.target_options
            cells.append(_cell(request, name, target, target_options))
            for defect in defects:
                options = {**target_options, "defects": [defect.name]}
                cells.append(_cell(request, name, target, options, defect.name))
    return plan_cells(cells, scenes, request.horizon_s, request.options.get("sim"))


def resolve_defects_request(
    request: Request, reporter: ProgressReporter, folder: Path | None = None
) -> tuple[SceneList, tuple[str, ...], tuple[str, ...]]:
    """Return the seed scenes, targets and backgrounds of the request; *folder* of the bench once it is begun.

    Raises:
        InputError: a name or defect is unknown, or the list of scenes cannot be used.
    """
    default_targets = {_DEFAULT_TARGET: _DEFAULT_TARGET}
    scenes, targets, names = resolve_request(
        request, reporter, default_targets, _BACKGROUNDS, DEFECTS_LIST, folder
    )
    for target in targets:
        planted_defects(target, request)
    for name in names:
        cell = _cell(request, name, "")
        made_background(cell.background, cell.background_options)  # raises an error for an unknown option
    return scenes, targets, names


def planted_defects(
    target: str, request: Request, reporter: ProgressReporter | None = None
) -> tuple[Defect, ...]:
    """Return the defects to plant in *target*: the requested ones, or all that this target supports.

    Raises:
        InputError: a defect is unknown, given twice, or requested for a target that does not support it.
    """
    texts = [text if ":" in text else f"{text}:{request.severity}" for text in request.defects or DEFECTS]
    defects = parse_defects(texts)
    target_options = request.episode.target_options
    driver = made_target(target, target_options)
    if not isinstance(driver, SumoDriver):
        return defects
    if request.defects:
        planted = {"defects": [defect.name for defect in defects]}
        made_target(target, {**target_options, **planted})  # raises an error for an unsupported one
    names = [defect.kind.name for defect in defects if defect.lacks_form(driver) is not None]
    if names and reporter is not None:
        reporter.say(f"left out, as SUMO, which drives {target}, has no form of them: {', '.join(names)}")
    return tuple(defect for defect in defects if defect.lacks_form(driver) is None)


def _cell(
    request: Request,
    name: str,
    target: str,
    options: Mapping[str, Any] = MappingProxyType({}),
    defect: str = SOUND,
) -> BenchCell:
    """Return the cell of the row *name*; without a licence in the request, its attackers have the default one."""
    row = policy_row(name)
    own_options = with_licence(row.options, request)
    if request.licence is None:
        own_options = {key: value for key, value in own_options.items() if key not in PAPERS_LICENCE}
    own_options |= request.episode.background_options
    return BenchCell(
        row=name,
        target=target,
        background=row.background,
        target_options=options,
        background_options=own_options,
        like=name,
        defect=defect,
    )
