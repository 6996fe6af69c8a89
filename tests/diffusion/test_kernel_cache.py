"""Shipped machine code fits the kernels as they are, changes are noticed, and it computes what the compiler makes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.diffusion.compiled import kernel_cache
from advdiff_sumo.diffusion.compiled.kernel import kernel
from advdiff_sumo.diffusion.compiled.kernel_cache import IGNORE_SHIPPED, fingerprint, shipped_code

_FACTOR = 2.0
_NEEDS_SHIPPED = pytest.mark.skipif(
    not shipped_code().exists(), reason=f"no code ships for this Python and system: {shipped_code().name}"
)


@kernel
def inner(x: FloatArray) -> float:
    """Return the first number of *x*, scaled."""
    return x[0] * _FACTOR


@kernel
def outer(x: FloatArray) -> float:
    """Return it once more scaled."""
    return 3.0 * inner(x)


def test_the_fingerprint_sees_numbers_and_what_is_called(monkeypatch: pytest.MonkeyPatch) -> None:
    own: Any = outer
    before = fingerprint(own.py_func)
    assert before == fingerprint(own.py_func)
    monkeypatch.setitem(globals(), "_FACTOR", 4.0)
    changed = fingerprint(own.py_func)
    monkeypatch.setitem(globals(), "inner", kernel(lambda x: x[1]))
    assert len({before, changed, fingerprint(own.py_func)}) == 3


def test_the_fingerprint_is_the_same_in_every_process() -> None:
    program = (
        "from advdiff_sumo.diffusion.compiled import kernel_cache, rollout\n"
        "print(kernel_cache.fingerprint(rollout.roll.py_func))"
    )
    assert _run(program, PYTHONHASHSEED="1") == _run(program, PYTHONHASHSEED="5")


_ONCE = """
import sys
import numpy as np
from advdiff_sumo.diffusion.compiled.kernel import product
out = np.zeros((2, 3), np.float32)
product(np.ones((2, 5), np.float32), np.full((5, 3), 2.0, np.float32), out)
print(out[0, 0], sum(product.stats.cache_hits.values()), sum(product.stats.cache_misses.values()))
"""


def _run(program: str, **variables: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
def test_what_was_compiled_is_kept_and_found_again(tmp_path: Path) -> None:
    places = {"NUMBA_CACHE_DIR": str(tmp_path / "code"), IGNORE_SHIPPED: "1"}
    assert _run(_ONCE, **places) == "10.0 0 1"
    assert _run(_ONCE, **places) == "10.0 1 0"
    (kept,) = (tmp_path / "code").iterdir()
    assert kept.name.startswith("advdiff_sumo.diffusion.compiled.kernel-product-")
    kept.write_bytes(kept.read_bytes()[:100])  # a disk that was full
    assert _run(_ONCE, **places) == "10.0 0 1"
    assert _run(_ONCE, **places) == "10.0 1 0"


def test_a_place_that_cannot_be_written_is_done_without(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert _run(_ONCE, NUMBA_CACHE_DIR=str(tmp_path / "file"), **{IGNORE_SHIPPED: "1"}) == "10.0 0 1"


_PLANS = """
import hashlib, sys
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.sim.sim_options import SceneOptions
scene = SceneOptions(warmup_s=30.0, scenes_per_warmup=1, min_neighbours=4)
run = Run.prepare(RunOptions(background="diffusion", target="IDM", scene=scene, horizon_s=2.0, seed=1))
record, timing = run.episode(0, next(run.seed_scenes())).run()
assert record.failure is None and len(timing.background_plans_s) == 4
misses = [name for name, module in sorted(sys.modules.items()) if name.startswith("advdiff_sumo")
          for one in vars(module).values() if sum(getattr(getattr(one, "stats", None), "cache_misses", {}).values())]
print(len(misses), hashlib.sha256(record.tracks.xy_m.tobytes()).hexdigest())
"""


@_NEEDS_SHIPPED
def test_a_guided_episode_compiles_nothing(tmp_path: Path) -> None:
    """Where this fails, a kernel has changed: run ``python tools/build_kernels.py`` and commit what it makes."""
    count, _ = _run(_PLANS, NUMBA_CACHE_DIR=str(tmp_path)).split()
    assert count == "0", "kernels have changed: run python tools/build_kernels.py"
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@_NEEDS_SHIPPED
def test_shipped_code_gives_the_bytes_of_code_compiled_here(tmp_path: Path) -> None:
    shipped = _run(_PLANS, NUMBA_CACHE_DIR=str(tmp_path / "a")).split()
    here = _run(_PLANS, NUMBA_CACHE_DIR=str(tmp_path / "b"), **{IGNORE_SHIPPED: "1"}).split()
    assert shipped[0] == "0"
    assert here[0] != "0"
    assert shipped[1] == here[1]
    assert len(list((tmp_path / "b").iterdir())) > len(kernel_cache._shipped())
