"""What ``bench defects`` tries: the sound target, the careful driver and each defect, before each background."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from advdiff_sumo.experiments.bench.bench_config import Folder, Request
from advdiff_sumo.experiments.bench.bench_rows import (
    PAPERS_LICENCE,
    REGISTERED,
    asked_of,
    licensed,
    policy_row,
)
from advdiff_sumo.experiments.bench.cells import BenchCell, BenchCells, plan_cells
from advdiff_sumo.experiments.bench.detection import too_few
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.scene_list import DEFECTS_LIST, SceneList
from advdiff_sumo.planners.defects import DEFECTS, Defect, parse_defects
from advdiff_sumo.planners.planner_protocol import SumoDriver
from advdiff_sumo.planners.planner_registry import TARGETS, make_target
from advdiff_sumo.traffic.policy_registry import make_policy

SOUND, CAREFUL = "sound", "careful"
_USUAL_TARGET = "lane_graph"
_BACKGROUNDS = {name: background for name, background in REGISTERED.items() if name != "traj2traj"} | {
    "scripted": "scripted"
}


def plan_defects(folder: Folder, teller: ProgressReporter) -> BenchCells:
    """Return the cells that the request asks for, one background after the other.

    Raises:
        InputError: a name is unknown, or the list of scenes cannot be used.
    """
    request = folder.request
    scenes, targets, names = asked_of_defects(request, teller, folder.path)
    planted = {target: planted_in(target, request, teller) for target in targets}
    for target, defects in planted.items():
        if lacking := too_few(len(scenes.scenes), target, len(defects)):
            teller.say(lacking)
    cells = []
    for name in names:
        if CAREFUL in TARGETS.names() and CAREFUL not in targets:
            cells.append(_cell(request, name, CAREFUL))
        for target, defects in planted.items():
            own = request.episode.target_options
            cells.append(_cell(request, name, target, own))
            cells += [_cell(request, name, target, {**own, "defects": [x.name]}, x.name) for x in defects]
    return plan_cells(cells, scenes, request.horizon_s, request.options.get("sim"))


def asked_of_defects(
    request: Request, teller: ProgressReporter, folder: Path | None = None
) -> tuple[SceneList, tuple[str, ...], tuple[str, ...]]:
    """Return the seed scenes, targets and backgrounds that the request asks for; *folder* of the bench once begun.

    Raises:
        InputError: a name or defect is unknown, or the list of scenes cannot be used.
    """
    usual = {_USUAL_TARGET: _USUAL_TARGET}
    scenes, targets, names = asked_of(request, teller, usual, _BACKGROUNDS, DEFECTS_LIST, folder)
    for target in targets:
        planted_in(target, request)
    for name in names:
        own = _cell(request, name, "")
        make_policy(own.background, own.background_options)  # says which option it does not have
    return scenes, targets, names


def planted_in(target: str, request: Request, teller: ProgressReporter | None = None) -> tuple[Defect, ...]:
    """Return the defects for *target*: those asked for, or all; of all, those that SUMO has no form of are left out.

    Raises:
        InputError: a defect is unknown, given twice, or has no form for this target.
    """
    texts = [text if ":" in text else f"{text}:{request.severity}" for text in request.defects or DEFECTS]
    defects = parse_defects(texts)
    own = request.episode.target_options
    driver = make_target(target, own)
    if not isinstance(driver, SumoDriver):
        return defects
    if request.defects:
        make_target(target, {**own, "defects": [defect.name for defect in defects]})  # says what has no form
    lacking = [defect.kind.name for defect in defects if defect.lacks_form(driver) is not None]
    if lacking and teller is not None:
        teller.say(f"left out, as SUMO, which drives {target}, has no form of them: {', '.join(lacking)}")
    return tuple(defect for defect in defects if defect.lacks_form(driver) is None)


def _cell(
    request: Request,
    name: str,
    target: str,
    options: Mapping[str, Any] = MappingProxyType({}),
    defect: str = SOUND,
) -> BenchCell:
    """Return the cell of the row *name*; its attackers keep to the law unless the request says otherwise."""
    row = policy_row(name)
    allowed = licensed(row.options, request)
    if request.licence is None:
        allowed = {key: value for key, value in allowed.items() if key not in PAPERS_LICENCE}
    allowed |= request.episode.background_options
    return BenchCell(
        row=name,
        target=target,
        background=row.background,
        target_options=options,
        background_options=allowed,
        like=name,
        defect=defect,
    )
