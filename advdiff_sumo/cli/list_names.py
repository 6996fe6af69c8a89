"""``advdiff-sumo list``: list the names that other verbs accept."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import Annotated

import typer

from advdiff_sumo.cli.terminal import terminal


class ListedKind(StrEnum):
    """Kinds of names that can be listed."""

    targets = "targets"
    backgrounds = "backgrounds"
    nets = "nets"
    defects = "defects"
    columns = "columns"


def list_names(
    kind: Annotated[ListedKind, typer.Argument(help="What to list.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List the targets, backgrounds, shipped nets or planted defects that there are, or the columns of the tables.

    Targets and backgrounds include plug-ins. Of a defect: what it stands for, its parameter with the values of weak,
    middle and strong, and SUMO's attributes.

    advdiff-sumo list targets
    """
    names = _described_names(kind)
    if as_json:
        typer.echo(json.dumps({kind.value: names}, ensure_ascii=False))
        return
    width = max(map(len, names))
    console = terminal(highlight=False, soft_wrap=True)
    for name, description in names.items():
        console.print(f"{name:<{width}}  {description}".rstrip())


def _described_names(kind: ListedKind) -> dict[str, str]:
    """Return the names of *kind* with their descriptions."""
    if kind is ListedKind.nets:
        from advdiff_sumo.maps.shipped_nets import NETS_BY_NAME, find_net

        return {name: str(find_net(name)) for name in NETS_BY_NAME}
    if kind is ListedKind.defects:
        from advdiff_sumo.planners.defects import DEFECTS

        return {name: defect.description for name, defect in DEFECTS.items()}
    if kind is ListedKind.columns:
        from advdiff_sumo.sweep.sweep_columns import described_columns

        return described_columns()
    if kind is ListedKind.targets:
        from advdiff_sumo.planners.planner_registry import TARGETS

        own = {"package.module:Class": "a planner of yours", "grpc://HOST:PORT": "a planner's server"}
        own["exec:COMMAND"] = "a planner's server, started for the run"
        return TARGETS.described() | own
    from advdiff_sumo.traffic.policy_registry import POLICIES

    return POLICIES.described() | {"package.module:Class": "a policy of yours"}
