"""Training runs on machines that have no SUMO: only a GPU, window files and PyTorch."""

from __future__ import annotations

import subprocess
import sys

_BLOCKED = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"libsumo", "traci", "sumolib", "sumo", "shapely", "pyproj", "pyarrow"}:
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Absent())
import advdiff_sumo.training.setup, advdiff_sumo.training.evaluation, advdiff_sumo.training.guide_adaptation
print("imported")
"""


def test_training_needs_no_sumo() -> None:
    done = subprocess.run([sys.executable, "-c", _BLOCKED], capture_output=True, text=True, check=False)
    assert done.stdout == "imported\n", done.stderr
