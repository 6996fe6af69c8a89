"""Write or check the lists of seed scenes in scenarios/benches: make_bench_scenes.py [--check] [--only NAME].

The same nets and version of SUMO give the same bytes.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from advdiff_sumo.experiments.bench.scene_list import (
    DEFECTS_HORIZON_S,
    DEFECTS_LIST,
    DEFECTS_SEED,
    HORIZON_S,
    JUNCTIONS_LIST,
    JUNCTIONS_SEED,
    RED_LIGHTS_LIST,
    RED_LIGHTS_SEED,
    TABLE_LIST,
    TABLE_SEED,
    TUNING_LIST,
    TUNING_SEED,
    Stratum,
    make_list,
    write_scene_list,
)
from advdiff_sumo.sim.sim_options import SceneOptions, Situation

FOLDER = Path(__file__).resolve().parents[1] / "scenarios" / "benches"
TOWN, MOTORWAY = ("downtown", "downtown-left"), ("motorway",)


def _scene_options(density_per_km: float, situation: Situation, min_speed_mps: float) -> SceneOptions:
    return SceneOptions(
        density_per_km=density_per_km,
        situation=situation,
        min_speed_mps=min_speed_mps,
        min_neighbours=5 if situation == "any" else 3,
        scenes_per_warmup=3,
    )


#: Dense traffic, and sparse traffic in which the target moves and approaches a situation that may reveal a defect.
STRATA = {
    "dense": Stratum(nets=(*TOWN, *MOTORWAY), scene=_scene_options(20.0, "any", 3.0)),
    "yielding": Stratum(nets=TOWN, scene=_scene_options(8.0, "yielding", 3.0)),
    "turning": Stratum(nets=TOWN, scene=_scene_options(4.0, "turning", 6.0)),
    "following": Stratum(nets=MOTORWAY, scene=_scene_options(8.0, "following", 15.0)),
    "merging": Stratum(nets=MOTORWAY, scene=_scene_options(8.0, "merging", 15.0)),
    "sparse": Stratum(nets=MOTORWAY, scene=_scene_options(4.0, "merging", 15.0)),
}
#: The target is the first vehicle at a red light; this is rare in the strata above.
RED_LIGHTS = {"red-light": Stratum(nets=TOWN, scene=_scene_options(8.0, "red-light", 6.0))}
#: The target turns across oncoming traffic with priority, or its light turns yellow; both are rare in these strata.
JUNCTIONS = {
    "oncoming": Stratum(nets=TOWN, scene=_scene_options(8.0, "oncoming", 5.0)),
    "yellow": Stratum(nets=TOWN, scene=_scene_options(8.0, "yellow", 6.0)),
}
#: Name → scenes per net or stratum, seed, description, horizon in s, strata.
LISTS: dict[str, tuple[int, int, str, float, Mapping[str, Stratum] | None]] = {
    TUNING_LIST: (20, TUNING_SEED, "to tune on: no table uses these scenes", HORIZON_S, None),
    TABLE_LIST: (100, TABLE_SEED, "seed scenes of the tables: nothing is tuned on them", HORIZON_S, None),
    DEFECTS_LIST: (
        *(30, DEFECTS_SEED, "seed scenes of bench defects, by situation: nothing is tuned on them"),
        *(DEFECTS_HORIZON_S, STRATA),
    ),
    RED_LIGHTS_LIST: (
        *(30, RED_LIGHTS_SEED, "seed scenes before red lights, for bench defects: nothing is tuned on them"),
        *(DEFECTS_HORIZON_S, RED_LIGHTS),
    ),
    JUNCTIONS_LIST: (
        15,
        JUNCTIONS_SEED,
        "seed scenes before oncoming traffic and yellow lights, for bench defects: nothing is tuned on them",
        DEFECTS_HORIZON_S,
        JUNCTIONS,
    ),
}


def main() -> int:
    """Write the lists; with ``--check``, return 1 if a list differs from what this tool makes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--only", choices=sorted(LISTS), help="this one alone")
    given = parser.parse_args()
    stale = 0
    for name, (count, seed, about, horizon_s, strata) in LISTS.items():
        if given.only in (None, name):
            scene_list = make_list(count, seed, about, horizon_s=horizon_s, strata=strata)
            path = FOLDER / f"{name}.json"
            with tempfile.TemporaryDirectory() as scratch:
                write_scene_list(Path(scratch) / path.name, scene_list)
                content = (Path(scratch) / path.name).read_bytes()
            if not given.check:
                path.write_bytes(content)
            elif not path.exists() or path.read_bytes() != content:
                stale += 1
            print(f"{path.name}: {len(scene_list.scenes)} scenes, sha256 {scene_list.sha256}")
    if stale:
        print(f"{stale} lists are not what this tool makes")
    return min(stale, 1)


if __name__ == "__main__":
    sys.exit(main())
