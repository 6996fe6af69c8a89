"""Composes the command line that repeats a margin, from its options."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from advdiff_sumo.maps.shipped_nets import net_name
from advdiff_sumo.sim.run_episodes import RunOptions

_OUT = "../again"
#: Text that needs no quotes in ``--set``, as TOML would not read it as another value.
_UNQUOTED = re.compile(r"(?!(?:true|false|inf|nan)$)[A-Za-z][\w./:-]*")
_MARGIN_DEFAULTS: Mapping[str, Any] = {"background": "scripted", "background_options": {"attackers": 1}}
_WITH_FLAG = ("net", "target", "demand", "horizon_s", "seed", "episodes")


def margin_command(
    options: RunOptions, number: int, attack: str, by: str | None = None, within: float | None = None
) -> str:
    """Return the command that repeats a margin in a new folder beside that of its results.

    Args:
        options: of the run with background ``scripted``; files are named by their full paths.
        number: which of the seed's scenes it is.
        attack: its kind, or all.
        by: name of the scale, if it was given.
        within: distance of the neighbouring values, in the scale's unit, if it was given.
    """
    target_options = dict(options.target_options)
    defects = target_options.get("defects")
    planted = target_options.pop("defects") if isinstance(defects, list | tuple) else ()
    flags: dict[str, str | float | None] = {
        "--target": options.target,
        "--net": net_name(options.net),
        "--attack": attack,
        "--by": by,
        "--within": within,
        "--demand": str(Path(options.demand).resolve()) if options.demand else None,
        "--horizon": options.horizon_s,
        "--seed": options.seed,
        "--number": number or None,
    }
    words = ["advdiff-sumo", "margin", *_flag_words(flags)]
    for defect in planted:
        words += ["--defect", str(defect)]
    for assignment in _assignments(options.model_copy(update={"target_options": target_options})):
        words += ["--set", assignment]
    return shlex.join([*words, "--out", _OUT])


def episode_margin_command(
    source: Sequence[str],
    flags: Mapping[str, str | float | None],
    defects: Sequence[str],
    assignments: Sequence[str],
) -> str:
    """Return the command that repeats the margin of an episode, in a new folder beside that of its results.

    Args:
        source: words that name the episode.
        flags: flag → value; None: it was not given.
        defects: values of ``--defect``.
        assignments: values of ``--set``.
    """
    words = ["advdiff-sumo", "margin", *source, *_flag_words(flags)]
    for flag, values in (("--defect", defects), ("--set", assignments)):
        for value in values:
            words += [flag, value]
    return shlex.join([*words, "--out", _OUT])


def _flag_words(flags: Mapping[str, str | float | None]) -> Iterator[str]:
    for flag, value in flags.items():
        if value is not None:
            yield from (flag, f"{value:g}" if isinstance(value, float) else str(value))


def _assignments(options: RunOptions) -> Iterator[str]:
    """Yield the arguments of ``--set``: options that differ from the defaults and have no flag of their own."""
    values = options.model_dump(mode="json", exclude=set(_WITH_FLAG))
    defaults = dict(_leaves(RunOptions().model_dump(mode="json") | dict(_MARGIN_DEFAULTS)))
    if options.scenes:
        values["scenes"] = str(Path(options.scenes).resolve())
    for name, value in _leaves(values):
        if value is not None and defaults.get(name) != value:
            is_unquoted = isinstance(value, str) and _UNQUOTED.fullmatch(value)
            yield f"{name}={value if is_unquoted else json.dumps(value, ensure_ascii=False)}"


def _leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested mappings by their dotted names."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
