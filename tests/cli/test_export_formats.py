"""The formats that ``advdiff-sumo export`` lists."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.cli.export import export
from advdiff_sumo.core.errors import UnknownNameError


def test_an_unknown_format_lists_all_too(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown format 'foo'; known are: all, commonroad, csv, fcd"):
        export(tmp_path, formats=["foo"])
