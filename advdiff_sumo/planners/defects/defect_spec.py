"""A defect as it is written, ``NAME:SEVERITY``, and planting several in a target."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from advdiff_sumo.core.errors import ConfigError, UnknownNameError, did_you_mean
from advdiff_sumo.planners.defects.catalogue import DEFECTS, SEVERITIES, DefectKind
from advdiff_sumo.planners.defects.defective_planner import with_faults
from advdiff_sumo.planners.planner_protocol import SumoDriver, Target
from advdiff_sumo.plugins import fold

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*(.*?)\s*", re.IGNORECASE)
_SPELLINGS = {"m/s2": "m/s²", "°": "deg"}
_WORSE_IF_GREATER = (
    *("actionStepLength", "jmDriveAfterRedTime", "jmDriveRedSpeed"),
    *("jmIgnoreFoeProb", "jmIgnoreFoeSpeed", "jmIgnoreJunctionFoeProb"),
)
_SUMO_TAU_S, _LEAST_TAU_S = 1.0, 0.1
_SUMO_BRAKES_MPS2 = {"decel": 4.5, "emergencyDecel": 9.0}
_NO_SHORTER_TAU = ("W99", "Wiedemann", "CACC")


@dataclass(frozen=True)
class Defect:
    """A defect with its severity.

    Attributes:
        kind: its entry in the catalogue.
        value: its severity, in the kind's unit.
    """

    kind: DefectKind
    value: float

    @property
    def name(self) -> str:
        """As it is written; a severity by its name where it has one."""
        named = dict(zip(self.kind.values, SEVERITIES, strict=True))
        return f"{self.kind.name}:{named.get(self.value, f'{self.value:g}')}"

    def lacks_form(self, driver: SumoDriver) -> str | None:
        """Return why SUMO has no form of it for *driver*; None where it has one."""
        if self.kind.sumo is None:
            return self.kind.sumo_note.removeprefix("none: ")
        if "tau" in self.kind.sumo(self.value) and driver.car_following in _NO_SHORTER_TAU:
            return f"{driver.car_following} follows no closer for a shorter tau"
        return None

    def sumo_params(self, driver: SumoDriver, name: str) -> dict[str, float]:
        """Return the vType attributes that plant it in *driver*, which is called *name*.

        Raises:
            ConfigError: SUMO has no form of it.
        """
        why = self.lacks_form(driver)
        if why is not None or self.kind.sumo is None:
            raise ConfigError(
                f"defect '{self.kind.name}' has no form for target '{name}', which SUMO drives: {why}; "
                "take a planner as the target, such as lane_graph"
            )
        return dict(self.kind.sumo(self.value))


def parse_defect(text: str) -> Defect:
    """Return the defect that *text* names, such as ``late:1.0``, ``late:1.0s`` or ``range:strong``.

    Raises:
        UnknownNameError: there is no such defect; with the nearest name.
        ConfigError: the severity is missing, is neither a name nor a number, or makes no sense.
    """
    name, _, severity = str(text).partition(":")
    by_fold = {fold(known): kind for known, kind in DEFECTS.items()}
    kind = by_fold.get(fold(name))
    if kind is None:
        raise UnknownNameError("defect", name.strip(), DEFECTS)
    named = dict(zip(SEVERITIES, kind.values, strict=True))
    word = severity.strip().lower()
    return Defect(kind, named[word] if word in named else _number(kind, severity))


def parse_defects(given: object) -> tuple[Defect, ...]:
    """Return the defects of a target's option ``defects``: one text, or several.

    Raises:
        InputError: it is nothing of that kind, or one of them as in :func:`parse_defect`.
    """
    texts = (given,) if isinstance(given, str) else given
    if not isinstance(texts, Sequence) or not all(isinstance(text, str) for text in texts):
        raise ConfigError(f'defects = {given!r}: expected a list of texts, such as ["late:1.0"]')
    defects = tuple(parse_defect(text) for text in texts)
    names = [defect.kind.name for defect in defects]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ConfigError(f"defect '{twice}' is given twice; leave one out")
    return defects


def plant(target: Target, defects: Sequence[Defect], name: str) -> Target:
    """Return *target* with *defects* in it; itself without any.

    Args:
        target: a planner, or one of SUMO's driver models.
        defects: in the order in which the target meets them.
        name: of the target, for messages.

    Raises:
        ConfigError: SUMO has no form of one of them.
    """
    if not defects:
        return target
    if not isinstance(target, SumoDriver):
        return with_faults(target, tuple(d.kind.fault(d.value) for d in defects))
    params: dict[str, Any] = dict(target.params)
    planted: dict[str, float] = {}
    for defect in defects:
        for key, value in defect.sumo_params(target, name).items():
            planted[key] = max(value, planted.get(key, value)) if key in _WORSE_IF_GREATER else value
    if "tau" in planted:
        planted["tau"] = max(float(params.get("tau", _SUMO_TAU_S)) + planted["tau"], _LEAST_TAU_S)
    for key in planted.keys() & _SUMO_BRAKES_MPS2.keys():  # weak brakes are no stronger than the target's own
        planted[key] = min(planted[key], float(params.get(key, _SUMO_BRAKES_MPS2[key])))
    for key in (
        planted.keys() & params.keys() & set(_WORSE_IF_GREATER)
    ):  # no defect mends what is worse already
        planted[key] = max(planted[key], _read(params[key], planted[key]))
    return replace(target, params=params | planted)


def _read(own: Any, otherwise: float) -> float:
    """Return the number that *own* is, *otherwise* where it is none, such as a text that SUMO alone can read."""
    try:
        number = float(own)
    except (TypeError, ValueError):
        return otherwise
    return otherwise if math.isnan(number) else number


def _number(kind: DefectKind, text: str) -> float:
    number = _NUMBER.fullmatch(text)
    unit = f" {kind.unit}" if kind.unit else ""
    choices = ", ".join(
        f"{name} ({value:g}{unit})" for name, value in zip(SEVERITIES, kind.values, strict=True)
    )
    if number is None:
        word = text.strip()
        if not word:
            raise ConfigError(f"defect '{kind.name}' lacks its severity; give {choices}, or a number")
        near = did_you_mean(word, SEVERITIES)
        hint = f"; {near} There are" if near.startswith("did") else "; give"
        raise ConfigError(f"defect '{kind.name}' has no severity '{word}'{hint} {choices}, or a number")
    unit_given = _SPELLINGS.get(number[2], number[2])
    if unit_given not in ("", kind.unit):
        raise ConfigError(
            f"defect '{kind.name}': its unit is '{kind.unit}', not '{number[2]}'; give {choices}"
        )
    value, (low, high) = float(number[1]), kind.bounds
    if not low <= value <= high:
        raise ConfigError(
            f"defect '{kind.name}': {value:g}{unit} is not within {low:g} to {high:g}{unit}; give {choices}"
        )
    return value
