"""Nets with any combination of rare but valid features can be driven: episodes end, and their states are sound."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.metric_rows import collision_rows, episode_row
from advdiff_sumo.sim.run_store import episode_tables
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from tests.example_counts import examples
from tests.rare_net import FEATURES, build
from tests.sim.scenes import episode

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
from soak_src.checks import States, problems

HORIZON_S = 2.0
SCENE = {
    "warmup_s": 12.0,
    "scenes_per_warmup": 1,
    "min_neighbours": 1,
    "min_route_m": 20.0,
    "min_speed_mps": 0.0,
    "density_per_km": 25.0,
}
#: What netconvert must have written if the feature is requested.
MARKS = {
    "uncontrolled link": 'uncontrolled="1"',
    "blinking light": 'state="o',
    "permission change": 'allow="bus"',
    "spaces in an id": 'tl="the light of E"',
    "internal lanes of no length": ':E_0_0" index="0" speed="13.90" length="0.10"',
    "turnarounds": 'dir="t"',
    "reversed roundabout": '<roundabout nodes="A B D G"',
    "bicycle lane": 'allow="bicycle"',
    "rail": 'tl="X" linkIndex="-1"',
    "sidewalks": 'function="walkingarea"',
    "opposite lane": "<neigh lane=",
    "stop offset": "<stopOffset",
    "no keep clear": 'keepClear="0"',
    "left hand": 'lefthand="true"',
    "projection": "+proj=utm",
    "non-ASCII ids": 'id="Straße-東"',
    "bends": 'id="NC_1"',
    "far away": 'x="3400000.00"',
}
FAST = settings(
    deadline=None,
    max_examples=3,
    phases=(Phase.generate,),
    derandomize=True,
    suppress_health_check=[*HealthCheck],
)
THOROUGH = settings(
    deadline=None,
    max_examples=examples(6, 25),
    suppress_health_check=[*HealthCheck],
)
SOME = st.sets(st.sampled_from(sorted(FEATURES)), min_size=2, max_size=8)


def scene_on(road: RoadMap, seed: int) -> SeedScene:
    """Return a seed scene of natural traffic."""
    options = SceneOptions.parse(SCENE)
    return NaturalTraffic(road, None, options, SimOptions(), HORIZON_S, SeedTree(seed)).batch(0)[0]


def drive(names: set[str], seed: int, target: str, background: str) -> list[str]:
    """Drive an episode on a net with the features *names*; return the faults that the soak test finds in it."""
    with tempfile.TemporaryDirectory() as folder:
        road = RoadMap.read(build(Path(folder), names))
        record, timing = episode(scene_on(road, seed), road, target, background, HORIZON_S).run()
        if record.failure is not None:
            return [str(record.failure)]
        tables = episode_tables(record, episode_row(record, road), collision_rows(record, road), timing)
        states = tables["states"]
        columns = {name: states.column(name).to_numpy() for name in states.column_names}
        moved = States.of(columns, replay=background == "replay")
        return list(problems(moved, road, tables["collisions"].to_pylist()))


def test_every_feature_has_its_mark() -> None:
    assert MARKS.keys() == FEATURES.keys()


@pytest.mark.parametrize("name", FEATURES)
def test_a_feature_is_in_the_net_that_is_read(tmp_path: Path, name: str) -> None:
    (tmp_path / "plain").mkdir()
    assert MARKS[name] in build(tmp_path, [name]).read_text(encoding="utf-8")
    if name != "internal lanes of no length":  # some joined junctions have such lanes without it
        assert MARKS[name] not in build(tmp_path / "plain", []).read_text(encoding="utf-8")
    assert RoadMap.read(tmp_path / "rare.net.xml").edge_graph().strongly_connected()


@pytest.mark.parametrize("background", ["sumo", pytest.param("diffusion", marks=pytest.mark.slow)])
def test_all_features_at_once(background: str) -> None:
    assert drive(set(FEATURES), 1, "lane_graph", background) == []


@FAST
@given(names=SOME, seed=st.integers(0, 9))
def test_natural_traffic_on_some_nets(names: set[str], seed: int) -> None:
    assert drive(names, seed, "IDM", "sumo") == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("target", "background"),
    [
        *(("IDM", "diffusion"), ("lane_graph", "replay"), ("lane_graph", "scripted")),
        *(pytest.param("IDM", name, marks=pytest.mark.nightly) for name in ("sumo", "replay", "scripted")),
        *(pytest.param("lane_graph", name, marks=pytest.mark.nightly) for name in ("sumo", "diffusion")),
    ],
)
@THOROUGH
@given(names=SOME, seed=st.integers(0, 99))
@example(names={"bends", "left hand", "reversed roundabout", "sidewalks"}, seed=7)
def test_any_traffic_on_any_net(target: str, background: str, names: set[str], seed: int) -> None:
    assert drive(names, seed, target, background) == []
