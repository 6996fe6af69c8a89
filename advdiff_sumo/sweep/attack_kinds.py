"""Find the kinds of attack that can be requested from a background."""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

from advdiff_sumo.config import Options
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.metrics.archive import ANY
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.traffic.policy_registry import POLICIES

_OPTION = "attack"


def attack_kinds(background: str, options: dict[str, object]) -> tuple[str, ...]:
    """Return the kinds of attack of *background* that are valid with its other *options*; () if it has no kinds.

    They are the possible values of its option ``attack``, including "any". If the option is given, only its value.
    """
    requested = options.get(_OPTION, ANY)
    if requested != ANY:
        return (str(requested),)  # the user's choice
    model = getattr(POLICIES.load(POLICIES.canonical(background)), "Options", None)
    if not (isinstance(model, type) and issubclass(model, Options) and _OPTION in model.model_fields):
        return ()
    names = map(str, get_args(model.model_fields[_OPTION].annotation))
    return tuple(name for name in names if _fits(model, {**options, _OPTION: name}))


def by_kind(cell: RunOptions) -> Iterator[RunOptions]:
    """Yield *cell* once for each kind of attack of its background; *cell* itself if there are none."""
    kinds = attack_kinds(cell.background, cell.background_options)
    for kind in kinds:
        yield cell.model_copy(update={"background_options": {**cell.background_options, _OPTION: kind}})
    if not kinds:
        yield cell


def _fits(model: type[Options], options: dict[str, object]) -> bool:
    """Return whether *options* are valid for *model*."""
    try:
        model.parse(options, "options")
    except ConfigError:
        return False
    return True
