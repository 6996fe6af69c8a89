"""The results of an episode do not depend on the number of threads of the libraries."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from advdiff_sumo.core.threads import VARIABLES

#: Background and target of each episode, and weights other than the default; all learned ones are included.
PAIRS = (
    *(("sumo", "IDM"), ("replay", "lane_graph"), ("diffusion", "lane_graph"), ("strive", "IDM")),
    *(
        ("advsim", "IDM"),
        ("adv-rl", "IDM"),
        ("sumo", "simnet"),
        ("sumo", "trafficsim"),
        ("diffusion", "diffusion"),
        ("diffusion", "IDM", "closed-loop"),
    ),
)
_PROGRAM = """
import hashlib, sys
import torch
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.sim.sim_options import SceneOptions

wide = torch.get_num_threads()
scene, first = SceneOptions(warmup_s=10.0, scenes_per_warmup=1, min_neighbours=1), None
for pair in sys.argv[1:]:
    background, target, *weights = pair.split(":")
    options = {"attackers": 2} if background == "diffusion" else {}
    options |= {"weights": weights[0]} if weights else {}
    run = Run.prepare(RunOptions(background=background, target=target, background_options=options, scene=scene,
                                 horizon_s=1.0, seed=3))
    first = first or next(run.seed_scenes())
    record, timing = run.episode(0, first).run()
    assert record.failure is None, record.failure
    assert background == "sumo" or len(timing.background_plans_s) == 2
    states = (record.tracks.xy_m, record.tracks.yaw_rad, record.tracks.speed_mps)
    print(pair, hashlib.sha256(b"".join(array.tobytes() for array in states)).hexdigest())
assert torch.get_num_threads() == wide, "the caller's threads come back"
print("threads", wide, file=sys.stderr)
"""


def _digests(threads: str | None) -> tuple[list[str], int]:
    """Return a line for each of ``PAIRS``, and PyTorch's number of threads; None: PyTorch chooses it."""
    environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    environment |= {} if threads is None else dict.fromkeys(VARIABLES, threads)
    words = [":".join(pair) for pair in PAIRS]
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, *words], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines(), int(done.stderr.split("threads")[-1])


@pytest.mark.slow
def test_the_number_of_threads_does_not_matter() -> None:
    one, free = _digests("1"), _digests(None)
    two = free if free[1] == 2 else _digests("2")
    assert (one[1], two[1]) == (1, 2)
    assert len(one[0]) == len(PAIRS)
    assert one[0] == two[0] == free[0]
