"""Names of classes and files are unique in the package, so that a search finds one result."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import advdiff_sumo

PACKAGE = Path(advdiff_sumo.__file__).parent
MODULES = sorted(path for path in PACKAGE.rglob("*.py") if not path.stem.endswith("_pb2"))

#: Public classes that two modules may define, and why.
ALLOWED: dict[str, str] = {}


def test_no_public_class_is_defined_in_two_modules() -> None:
    places = defaultdict[str, list[str]](list)
    for path in MODULES:
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path.relative_to(PACKAGE)))
    assert {name: paths for name, paths in places.items() if len(paths) > 1 and name not in ALLOWED} == {}


def test_no_file_name_occurs_more_than_twice() -> None:
    places = defaultdict[str, list[str]](list)
    for path in MODULES:
        if not path.stem.startswith("__"):
            places[path.stem].append(str(path.relative_to(PACKAGE)))
    assert {name: paths for name, paths in places.items() if len(paths) > 2} == {}
