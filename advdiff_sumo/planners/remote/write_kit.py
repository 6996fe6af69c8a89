"""Write the planner kit as a distribution of its own, for environments that cannot hold this package."""

from __future__ import annotations

from pathlib import Path

import advdiff_sumo
from advdiff_sumo.core.errors import FileError, os_reason
from advdiff_sumo.core.whole_file import is_free

#: Files that a planner's server imports, relative to this package.
KIT_FILES = (
    *("__init__.py", "py.typed", "core/__init__.py"),
    *("core/arrays.py", "core/kinematic_states.py", "core/output.py", "core/plan.py", "core/plan_form.py"),
    *("core/plug_in_source.py", "core/scene.py"),
)
_PROJECT = """\
[build-system]
requires = ["setuptools>=61"]
build-backend = "setuptools.build_meta"

[project]
name = "advdiff-planner"
version = "{version}"
description = "Serves a driving planner to advdiff-sumo; not for an environment that holds advdiff-sumo itself"
requires-python = ">=3.10"
license = {{ text = "Apache-2.0" }}
dependencies = ["grpcio>=1.48", "protobuf>=3.20", "numpy>=1.23"]

[tool.setuptools]
packages = ["advdiff_sumo", "advdiff_sumo.core", "advdiff_sumo.planner_kit"]

[tool.setuptools.package-data]
"advdiff_sumo" = ["py.typed", "planner_kit/planner.*"]
"""


def write_kit(folder: Path) -> list[Path]:
    """Write the kit into *folder*, which pip can install, and return the files.

    Raises:
        FileError: the folder exists and is not empty, or cannot be written.
    """
    if not is_free(folder):
        raise FileError(folder, "is there already", "name a new folder")
    source = Path(advdiff_sumo.__file__).parent
    kit = sorted(p.relative_to(source) for p in (source / "planner_kit").iterdir() if p.is_file())
    written = [folder / "pyproject.toml"]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        written[0].write_text(_PROJECT.format(version=advdiff_sumo.__version__), encoding="utf-8")
        for name in (*map(Path, KIT_FILES), *kit):
            copy = folder / "advdiff_sumo" / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes((source / name).read_bytes())
            written.append(copy)
    except OSError as error:
        raise FileError(folder, f"cannot be written ({os_reason(error)})") from None
    return written
