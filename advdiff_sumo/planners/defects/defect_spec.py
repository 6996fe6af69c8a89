"""Parse defects written as ``NAME:SEVERITY``, and plant them in a target."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from advdiff_sumo.core.errors import ConfigError, UnknownNameError, did_you_mean
from advdiff_sumo.planners.defects.catalogue import DEFECTS, SEVERITIES, DefectKind
from advdiff_sumo.planners.defects.defective_planner import with_defects
from advdiff_sumo.planners.planner_protocol import SumoDriver, Target
from advdiff_sumo.plugins import fold

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*(.*?)\s*", re.IGNORECASE)
_SPELLINGS = {"m/s2": "m/s²", "°": "deg"}
_WORSE_IF_GREATER = (
    *("actionStepLength", "jmDriveAfterRedTime", "jmDriveRedSpeed"),
    *("jmIgnoreFoeProb", "jmIgnoreFoeSpeed", "jmIgnoreJunctionFoeProb"),
)
"""SUMO's attributes of which the greater value is the worse one."""
_SUMO_TAU_S, _MIN_TAU_S = 1.0, 0.1  # SUMO's default, least value of a target with a defect
_SUMO_BRAKES_MPS2 = {"decel": 4.5, "emergencyDecel": 9.0}  # SUMO's defaults
_NO_SHORTER_TAU = ("W99", "Wiedemann", "CACC")  # models that follow no closer if tau is shorter


@dataclass(frozen=True)
class Defect:
    """A defect with its severity.

    Attributes:
        kind: its entry in the catalogue.
        value: severity, in the kind's unit.
    """

    kind: DefectKind
    value: float

    @property
    def name(self) -> str:
        """The defect as written; a severity that has a name is written as its name."""
        named = dict(zip(self.kind.values, SEVERITIES, strict=True))
        return f"{self.kind.name}:{named.get(self.value, f'{self.value:g}')}"

    def lacks_form(self, driver: SumoDriver) -> str | None:
        """Return why *driver* cannot have the defect; None if it can."""
        if self.kind.sumo is None:
            return self.kind.sumo_note.removeprefix("none: ")
        if "tau" in self.kind.sumo(self.value) and driver.car_following in _NO_SHORTER_TAU:
            return f"{driver.car_following} follows no closer for a shorter tau"
        return None

    def sumo_params(self, driver: SumoDriver, name: str) -> dict[str, float]:
        """Return the vType attributes that plant the defect in *driver*, the target *name*.

        Raises:
            ConfigError: SUMO has no attribute for it.
        """
        reason = self.lacks_form(driver)
        if reason is not None or self.kind.sumo is None:
            raise ConfigError(
                f"defect '{self.kind.name}' has no form for target '{name}', which SUMO drives: {reason}; "
                "take a planner as the target, such as lane_graph"
            )
        return dict(self.kind.sumo(self.value))


def parse_defect(text: str) -> Defect:
    """Return the defect that *text* names, such as ``late:1.0``, ``late:1.0s`` or ``range:strong``.

    Raises:
        UnknownNameError: no such defect; with the nearest name.
        ConfigError: the severity is missing, unknown, or out of bounds.
    """
    name, _, severity = str(text).partition(":")
    by_fold = {fold(known): kind for known, kind in DEFECTS.items()}
    kind = by_fold.get(fold(name))
    if kind is None:
        raise UnknownNameError("defect", name.strip(), DEFECTS)
    named = dict(zip(SEVERITIES, kind.values, strict=True))
    word = severity.strip().lower()
    return Defect(kind, named[word] if word in named else _severity(kind, severity))


def parse_defects(given: object) -> tuple[Defect, ...]:
    """Return the defects of a target's option ``defects``: one text, or a list of texts.

    Raises:
        InputError: it is neither, a defect is given twice, or as in :func:`parse_defect`.
    """
    texts = (given,) if isinstance(given, str) else given
    if not isinstance(texts, Sequence) or not all(isinstance(text, str) for text in texts):
        raise ConfigError(f'defects = {given!r}: expected a list of texts, such as ["late:1.0"]')
    defects = tuple(parse_defect(text) for text in texts)
    names = [defect.kind.name for defect in defects]
    duplicate = next((name for name in names if names.count(name) > 1), None)
    if duplicate is not None:
        raise ConfigError(f"defect '{duplicate}' is given twice; leave one out")
    return defects


def plant(target: Target, defects: Sequence[Defect], name: str) -> Target:
    """Return *target* with *defects*; *target* itself if there are none.

    Args:
        target: a planner, or one of SUMO's driver models.
        defects: in the order in which the perception passes through them.
        name: name of the target, for messages.

    Raises:
        ConfigError: SUMO has no attribute for one of them.
    """
    if not defects:
        return target
    if not isinstance(target, SumoDriver):
        return with_defects(target, tuple(d.kind.fault(d.value) for d in defects))
    params: dict[str, Any] = dict(target.params)
    planted: dict[str, float] = {}
    for defect in defects:
        for key, value in defect.sumo_params(target, name).items():
            planted[key] = max(value, planted.get(key, value)) if key in _WORSE_IF_GREATER else value
    if "tau" in planted:
        planted["tau"] = max(float(params.get("tau", _SUMO_TAU_S)) + planted["tau"], _MIN_TAU_S)
    # a defect never improves the target's own value
    for key in planted.keys() & _SUMO_BRAKES_MPS2.keys():
        planted[key] = min(planted[key], float(params.get(key, _SUMO_BRAKES_MPS2[key])))
    for key in planted.keys() & params.keys() & set(_WORSE_IF_GREATER):
        planted[key] = max(planted[key], _float_or(params[key], planted[key]))
    return replace(target, params=params | planted)


def _float_or(value: Any, default: float) -> float:
    """Return *value* as a number; *default* if it is none, such as a distribution in SUMO's notation."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return default
    return default if math.isnan(number) else number


def _severity(kind: DefectKind, text: str) -> float:
    """Return the severity given as a number, with or without its unit."""
    match = _NUMBER.fullmatch(text)
    unit = f" {kind.unit}" if kind.unit else ""
    choices = ", ".join(
        f"{name} ({value:g}{unit})" for name, value in zip(SEVERITIES, kind.values, strict=True)
    )
    if match is None:
        word = text.strip()
        if not word:
            raise ConfigError(f"defect '{kind.name}' lacks its severity; give {choices}, or a number")
        suggestion = did_you_mean(word, SEVERITIES)
        hint = f"; {suggestion} There are" if suggestion.startswith("did") else "; give"
        raise ConfigError(f"defect '{kind.name}' has no severity '{word}'{hint} {choices}, or a number")
    unit_given = _SPELLINGS.get(match[2], match[2])
    if unit_given not in ("", kind.unit):
        raise ConfigError(
            f"defect '{kind.name}': its unit is '{kind.unit}', not '{match[2]}'; give {choices}"
        )
    value, (low, high) = float(match[1]), kind.bounds
    if not low <= value <= high:
        raise ConfigError(
            f"defect '{kind.name}': {value:g}{unit} is not within {low:g} to {high:g}{unit}; give {choices}"
        )
    return value
