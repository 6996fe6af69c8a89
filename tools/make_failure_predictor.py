#!/usr/bin/env python3
"""Make ``advdiff_sumo/weights/failures.safetensors``: the prior for a planner that has had no encounters yet.

Planners with planted defects, and two sound ones, have the same lawful encounters of all kinds, on seed scenes that no
table uses. The prior of ``models.failure_predictor`` is fitted to their outcomes. It takes some minutes on one core;
the same command continues after an interruption. The same revision gives the same bytes.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from failure_prior import fit_prior

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.threads import one_thread_for_good
from advdiff_sumo.core.worker_pool import Task, in_processes
from advdiff_sumo.experiments.bench.scene_list import TUNING_SEED
from advdiff_sumo.experiments.failure_warmup import SCENE, meet
from advdiff_sumo.maps.shipped_nets import SHIPPED_NETS
from advdiff_sumo.models.failure_predictor import FailurePredictor, save_failures
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.sim.run_episodes import RunOptions, git_revision
from advdiff_sumo.traffic.manoeuvres.encounter_features import FEATURES
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS

SOUND = ("lane_graph", "careful")
DEFECTS = (
    *("late", "range", "flicker", "dropout", "tunnel", "blind-crossing", "blind-oncoming", "blind-standing"),
    *("blind-heavy", "frozen", "constant-velocity", "weak-brakes", "signals", "priority", "cut-in", "stuck"),
)
"""Planted at the severity ``strong``; the other defects of the catalogue are left for tests."""
PLANS = 108
"""Number of plans on each net."""
INTERCEPT = -3.0
"""Prior mean of the coefficients of kinds of encounters."""


def main() -> int:
    """Run the missing encounters, print the cross-validation, and write the prior."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="for what was gathered, e.g. build/failures")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, default=shipped_weights("failures"))
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    planners = [*SOUND, *(f"lane_graph/{defect}:strong" for defect in DEFECTS)]
    paths = {given.folder / f"{name.replace('/', '_').replace(':', '=')}.npz": name for name in planners}
    tasks: dict[Path, Task] = {
        path: (gather, name, path) for path, name in paths.items() if not path.exists()
    }
    for path, _ in in_processes(tasks, given.workers):
        print(path.stem, flush=True)
    met = {name: read(path) for path, name in paths.items()}
    check_left_out(met)
    save_failures(fitted(list(met.values())), given.out, {"revision": git_revision(), "planners": planners})
    print(given.out)
    return 0


def gather(name: str, path: Path) -> None:
    """Let the planner *name* have the same encounters on each shipped net; write their features and outcomes."""
    one_thread_for_good()
    target, _, defect = name.partition("/")
    count = len(FEATURES)
    flat = FailurePredictor(np.zeros(count), 1e-6 * np.eye(count), np.zeros((len(KINDS), count)))
    met = []
    for net in SHIPPED_NETS:
        options = RunOptions(
            net=net,
            target=target,
            target_options={"defects": [defect]} if defect else {},
            background="scripted",
            seed=TUNING_SEED + 600,
            horizon_s=9.0,
            scene=SCENE.model_copy(update={"density_per_km": 4.0}),
        )
        met.append(meet(options, flat, PLANS, lambda _: None, learns=False, probes=False))
    features, outcomes = (
        np.concatenate([getattr(result, part) for result in met]) for part in ("features", "outcomes")
    )
    np.savez(path, X=features, Y=outcomes)


def read(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return features and outcomes that :func:`gather` wrote."""
    with np.load(path, allow_pickle=False) as file:
        return file["X"], file["Y"]


def fitted(met: list[tuple[FloatArray, FloatArray]]) -> FailurePredictor:
    """Return the prior fitted to the encounters of planners."""
    return fit_prior(met, len(KINDS), INTERCEPT)


def check_left_out(met: dict[str, tuple[FloatArray, FloatArray]]) -> None:
    """Print how well each planner is predicted from the others alone, and also from a third of its own encounters."""
    print(f"{'left out':36} encounters  failures  loss: prior, adapted   AUC: prior, adapted")
    for name, (x, y) in met.items():
        prior = fitted([other for key, other in met.items() if key != name])
        is_known = np.arange(len(y)) % 3 == 0
        adapted = prior.adapted(x[is_known], y[is_known])
        test_x, test_y = x[~is_known], y[~is_known]
        figures = [(loss(model, test_x, test_y), auc(model, test_x, test_y)) for model in (prior, adapted)]
        print(
            f"{name:36} {len(y):10} {int((y == 1.0).sum()):9}  "
            f"{figures[0][0]:10.2f} {figures[1][0]:8.2f}   {figures[0][1]:10.2f} {figures[1][1]:8.2f}"
        )


def loss(predictor: FailurePredictor, features: FloatArray, outcomes: FloatArray) -> float:
    """Return the mean cross-entropy in nats."""
    p = np.clip(predictor.probability(features), 1e-6, 1.0 - 1e-6)
    return float(-(outcomes * np.log(p) + (1.0 - outcomes) * np.log1p(-p)).mean())


def auc(predictor: FailurePredictor, features: FloatArray, outcomes: FloatArray) -> float:
    """Return the probability that a failure is ranked above another outcome; NaN if there is no such pair."""
    p, failed = predictor.probability(features), outcomes == 1.0
    above = p[failed][:, None] - p[~failed][None]
    return float((above > 0.0).mean() + 0.5 * (above == 0.0).mean()) if above.size else float("nan")


if __name__ == "__main__":
    sys.exit(main())
