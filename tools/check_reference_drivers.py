"""Compare the reference drivers of UN R157 with a grid of outcomes; exit code 1 if a model agrees below 99.5 %.

python tools/check_reference_drivers.py FILE.csv[.gz] [--differences]

The columns determine which of three grids it is: cut-in (ego_kmh, other_kmh, gap_m, lateral_mps and one column for each
model), cut-out (model, speed_kmh, front_gap_m, lateral_mps, crash) or car following (model, decel_g, speed_kmh, crash).
"""

from __future__ import annotations

import argparse
import csv
import gzip
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from reference_src.r157_scenarios import car_following, cut_in, cut_out

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.errors import InputError
from advdiff_sumo.metrics.reference.driver_models import MODELS, DriverModel

LEAST_AGREEMENT = 0.995
_KMH = 1.0 / 3.6
Columns = dict[str, list[str]]
Outcome = Callable[[DriverModel, dict[str, FloatArray]], BoolArray]

_CUT_IN = ("ego_kmh", "other_kmh", "gap_m", "lateral_mps")
_CUT_OUT = ("speed_kmh", "front_gap_m", "lateral_mps")
_FOLLOWING = ("decel_g", "speed_kmh")


def main() -> int:
    """Print each model's agreement with the grid; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path, help="grid of outcomes, .csv or .csv.gz")
    parser.add_argument("--differences", action="store_true", help="print the cells that differ")
    given = parser.parse_args()
    try:
        columns = read_columns(given.file)
        kind, cells = compare(given.file, columns)
    except InputError as error:
        print(f"check_reference_drivers: {error}", file=sys.stderr)
        return 2
    print(f"{given.file.name}: {kind}")
    print(f"{'model':<16}{'cells':>8}{'agree':>8}{'share':>10}{'only theirs':>13}{'only ours':>11}")
    worst = 1.0
    for model, (keys, ours, theirs) in cells.items():
        same = ours == theirs
        worst = min(worst, float(same.mean()))
        missed, extra = int((theirs & ~ours).sum()), int((ours & ~theirs).sum())
        print(f"{model:<16}{len(same):>8}{int(same.sum()):>8}{same.mean():>9.3%}{missed:>13}{extra:>11}")
        if given.differences:
            for cell in np.flatnonzero(~same):
                values = ", ".join(f"{name} {keys[name][cell]:g}" for name in keys)
                print(f"    {'theirs' if theirs[cell] else 'ours'} collides: {values}")
    return 0 if worst >= LEAST_AGREEMENT else 1


def read_columns(path: Path) -> Columns:
    """Return the columns of a CSV file, gzipped or not.

    Raises:
        InputError: the file is missing, is not CSV, or is empty.
    """
    try:
        raw = path.read_bytes()
        text = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode("utf-8")
        rows = list(csv.reader(text.splitlines()))
    except (OSError, EOFError, zlib.error, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as CSV ({error}); give a grid of outcomes") from None
    if len(rows) < 2:
        raise InputError(f"{path}: holds no cells; give a grid of outcomes")
    short = next((number for number, row in enumerate(rows, start=1) if len(row) != len(rows[0])), None)
    if short is not None:
        raise InputError(f"{path}: line {short} has another number of columns than the first; mend it")
    return {name: [row[column] for row in rows[1:]] for column, name in enumerate(rows[0])}


def compare(
    path: Path, columns: Columns
) -> tuple[str, dict[str, tuple[dict[str, FloatArray], BoolArray, BoolArray]]]:
    """Return the kind of grid, and for each model its keys, our outcomes and those of the grid.

    Raises:
        InputError: the columns are those of no known grid, or a cell is not a number.
    """
    present = set(columns)
    if present >= set(_CUT_IN) and present & set(MODELS):
        keys = _numbers(path, columns, _CUT_IN)
        models = [name for name in MODELS if name in present]
        return "cut-in", {
            name: (keys, _cut_in(MODELS[name], keys), _numbers(path, columns, (name,))[name] > 0.5)
            for name in models
        }
    for kind, names, outcome in (("cut-out", _CUT_OUT, _cut_out), ("car following", _FOLLOWING, _following)):
        if present >= {"model", "crash", *names}:
            return kind, _by_model(path, columns, names, outcome)
    raise InputError(f"{path}: its columns ({', '.join(columns)}) are those of no grid; see --help")


def _by_model(
    path: Path, columns: Columns, names: tuple[str, ...], outcome: Outcome
) -> dict[str, tuple[dict[str, FloatArray], BoolArray, BoolArray]]:
    values = _numbers(path, columns, (*names, "crash"))
    model = np.array(columns["model"])
    unknown = sorted(set(columns["model"]) - set(MODELS))
    if unknown:
        raise InputError(f"{path}: no model '{unknown[0]}'; known are {', '.join(MODELS)}")
    outcomes = {}
    for name in (x for x in MODELS if x in set(columns["model"])):
        keys = {key: values[key][model == name] for key in names}
        outcomes[name] = keys, outcome(MODELS[name], keys), values["crash"][model == name] > 0.5
    return outcomes


def _numbers(path: Path, columns: Columns, names: tuple[str, ...]) -> dict[str, FloatArray]:
    try:
        return {name: np.array(columns[name], dtype=np.float64) for name in names}
    except ValueError as error:
        raise InputError(f"{path}: {error}; every cell must be a number") from None


def _cut_in(model: DriverModel, keys: dict[str, FloatArray]) -> BoolArray:
    # The grid has steps of 0.1 m/s. The number of time steps of a ramp depends on the last digit of such a product.
    lateral = np.round(keys["lateral_mps"] * 10.0) * 0.1
    return cut_in(model, keys["ego_kmh"] * _KMH, keys["other_kmh"] * _KMH, keys["gap_m"], lateral)


def _cut_out(model: DriverModel, keys: dict[str, FloatArray]) -> BoolArray:
    return cut_out(model, keys["speed_kmh"] * _KMH, keys["front_gap_m"], keys["lateral_mps"])


def _following(model: DriverModel, keys: dict[str, FloatArray]) -> BoolArray:
    return car_following(model, keys["speed_kmh"] * _KMH, keys["decel_g"])[0]


if __name__ == "__main__":
    sys.exit(main())
