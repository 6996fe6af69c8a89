"""Make the machine code of the planning loops that ships with the package, for this Python on this kind of machine.

    python tools/build_kernels.py

Every background and target that plans with networks drives a few seconds: once to compile, once more to see which
kernels Python itself calls. The code of those, which has all that they call in it, goes into
``advdiff_sumo/weights/kernels-….zip``. Run it after a change to a kernel (`tests/diffusion/test_kernel_cache.py` says
when) and after a new version of numba; it takes two minutes.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any

from advdiff_sumo.diffusion.compiled import kernel_cache
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.sim.sim_options import SceneOptions

_ATTACKS = ("any", "cut-in", "rear-end", "head-on", "junction", "brake")
#: Background, its options, and target.
EPISODES: tuple[tuple[str, dict[str, Any], str], ...] = (
    *(("diffusion", {"attack": k, "attackers": 2, "licence": "reckless"}, "IDM") for k in _ATTACKS),
    *(("diffusion", {"guide": "none"}, "diffusion"), ("sumo", {}, "trafficsim"), ("sumo", {}, "simnet")),
    *((rival, {"licence": "reckless"}, "IDM") for rival in ("strive", "advsim", "adv-rl")),
)
_SCENE = SceneOptions(warmup_s=30.0, scenes_per_warmup=1, min_neighbours=4)


def drive() -> None:
    """Run the episodes, each for two seconds."""
    for background, options, target in EPISODES:
        run = Run.prepare(
            RunOptions(
                background=background, background_options=options, target=target, scene=_SCENE, horizon_s=2.0
            )
        )
        record, _ = run.episode(0, next(run.seed_scenes())).run()
        if record.failure is not None:
            raise SystemExit(f"{background}, {target}: {record.failure}")


def called(file: Path) -> None:
    """Write the names of the kernels that Python asked for while the episodes ran to *file*."""
    names: list[str] = []
    load = kernel_cache._Files.load

    def noted(entry: Any, key: tuple[Any, ...]) -> Any:
        names.append(entry._name(key))
        return load(entry, key)

    kernel_cache._Files.load = noted  # type: ignore[method-assign] # listening is all that it does
    drive()
    file.write_text("\n".join(sorted(set(names))))


def build() -> None:
    """Compile, listen, pack."""
    with tempfile.TemporaryDirectory() as name:
        folder, listed = Path(name), Path(name) / "called.txt"
        environment = {
            **os.environ,
            "NUMBA_CACHE_DIR": str(folder / "code"),
            kernel_cache.IGNORE_SHIPPED: "1",
        }
        for words in ((), ("--called", str(listed))):
            step = "listening" if words else "compiling"
            print(f"{step} …", flush=True)
            subprocess.run([sys.executable, __file__, "--drive", *words], env=environment, check=True)
        path = kernel_cache.shipped_code()
        with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
            for entry in listed.read_text().splitlines():
                stamped = zipfile.ZipInfo(entry)  # of 1980: the same content, the same bytes
                archive.writestr(stamped, (folder / "code" / entry).read_bytes(), zipfile.ZIP_LZMA)
        print(f"{path}: {len(listed.read_text().splitlines())} kernels, {path.stat().st_size / 1e6:.2f} MB")


def main() -> None:
    """Build, or do one of its steps in this process."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drive", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--called", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if not given.drive:
        build()
    elif given.called is None:
        drive()
    else:
        called(given.called)


if __name__ == "__main__":
    main()
