"""The paper's own figures, as its text prints them: percent, and divergences times a hundred."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files


@dataclass(frozen=True)
class PaperTable:
    """One of its tables.

    Attributes:
        name: as the paper numbers it.
        rows: row → column → figure, in the units of our own table.
    """

    name: str
    rows: Mapping[str, Mapping[str, float]]

    def figure(self, row: str, column: str) -> float | None:
        """Return a figure; None where the paper has none."""
        return self.rows.get(row, {}).get(column)


def paper_table(bench: str) -> PaperTable:
    """Return the table that *bench* corresponds to."""
    text = files(__package__).joinpath("paper.json").read_text(encoding="utf-8")
    content = json.loads(text)[bench]
    return PaperTable(content["table"], content["rows"])
