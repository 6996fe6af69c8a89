"""Lists the export formats by name, and creates their exporters."""

from __future__ import annotations

from typing import cast

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.plug_in_source import described, raised_at
from advdiff_sumo.export.exporter_protocol import Exporter
from advdiff_sumo.plugins import Registry, must_have

EXPORTERS = Registry(
    kind="format",
    group="advdiff_sumo.exporters",
    builtins={
        "openscenario": "advdiff_sumo.export.openscenario_export:OpenScenario",
        "commonroad": "advdiff_sumo.export.commonroad_export:CommonRoad",
        "scenarionet": "advdiff_sumo.export.scenarionet_record:ScenarioNet",
        "fcd": "advdiff_sumo.export.fcd_export:Fcd",
        "csv": "advdiff_sumo.export.csv_export:Csv",
    },
)
"""The built-in formats and plug-ins of the group ``advdiff_sumo.exporters``."""


def make_exporter(name: str) -> Exporter:
    """Return the exporter with this name.

    Args:
        name: a built-in or plug-in (case, hyphen and underscore do not matter), or ``package.module:Class``.

    Raises:
        UnknownNameError: no such format; the message suggests the nearest name.
        ConfigError: the class cannot be imported or made, or is no exporter.
    """
    canonical = EXPORTERS.canonical(name)
    factory = EXPORTERS.load(canonical)
    try:
        exporter = factory() if callable(factory) else factory
    except Exception as error:  # a user's class may raise anything
        place = raised_at(error, None)
        raise ConfigError(
            f"format '{canonical}' cannot be made: {described(error)}{place}; correct it"
        ) from error
    must_have(f"format '{canonical}' is no exporter: it", exporter, ("write", "read"))
    return cast("Exporter", exporter)
