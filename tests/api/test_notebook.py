"""The notebook of the docs runs completely and shows the results that it describes."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from tests.hang_guard import HANG_S

NOTEBOOK = Path(__file__).parents[2] / "docs/notebooks/first_steps.ipynb"


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the kernel's own libraries
def test_the_notebook(tmp_path: Path) -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    client = NotebookClient(notebook, timeout=round(HANG_S), resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    shown = [
        output.get("data", {}).get("text/html", "")
        for cell in notebook.cells
        for output in cell.get("outputs", [])
    ]
    assert any("data:image/png;base64," in html for html in shown)
    assert any(html.startswith("<iframe") for html in shown)
    assert any("4 of 4 episodes" in html for html in shown)
    assert list(tmp_path.glob("runs/*/report.html"))
