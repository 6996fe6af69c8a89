"""Make the lists of seed scenes in scenarios/benches, or check them: make_bench_scenes.py [--check] [--only NAME].

The same nets and version of SUMO give the same bytes.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from advdiff_sumo.experiments.bench.scene_list import (
    DEFECTS_HORIZON_S,
    DEFECTS_LIST,
    DEFECTS_SEED,
    HORIZON_S,
    TABLE_LIST,
    TABLE_SEED,
    TUNING_LIST,
    TUNING_SEED,
    make_list,
    write_scene_list,
)
from advdiff_sumo.sim.sim_options import SceneOptions

FOLDER = Path(__file__).resolve().parents[1] / "scenarios" / "benches"
LISTS = {
    TUNING_LIST: (20, TUNING_SEED, "to tune on: no table uses these scenes", SceneOptions(), HORIZON_S),
    TABLE_LIST: (
        *(100, TABLE_SEED, "seed scenes of the tables: nothing is tuned on them"),
        *(SceneOptions(), HORIZON_S),
    ),
    DEFECTS_LIST: (
        *(100, DEFECTS_SEED, "dense seed scenes of bench defects: nothing is tuned on them"),
        *(SceneOptions(density_per_km=20.0, min_neighbours=5, min_speed_mps=3.0), DEFECTS_HORIZON_S),
    ),
}


def main() -> int:
    """Write the lists, or with ``--check`` return 1 when one is not what this tool makes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--only", choices=sorted(LISTS), help="this one alone")
    asked = parser.parse_args()
    stale = 0
    for name, (per_net, seed, about, scene, horizon_s) in LISTS.items():
        if asked.only in (None, name):
            scene_list = make_list(per_net, seed, about, scene=scene, horizon_s=horizon_s)
            path = FOLDER / f"{name}.json"
            with tempfile.TemporaryDirectory() as aside:
                write_scene_list(Path(aside) / path.name, scene_list)
                content = (Path(aside) / path.name).read_bytes()
            if not asked.check:
                path.write_bytes(content)
            elif not path.exists() or path.read_bytes() != content:
                stale += 1
            print(f"{path.name}: {len(scene_list.scenes)} scenes, sha256 {scene_list.sha256}")
    if stale:
        print(f"{stale} lists are not what this tool makes")
    return min(stale, 1)


if __name__ == "__main__":
    sys.exit(main())
