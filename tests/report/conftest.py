"""Run folders made by hand, so that every figure on the page is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import tomli_w

from advdiff_sumo.metrics.columns import COLLISION_COLUMNS, EPISODE_COLUMNS
from advdiff_sumo.sim.run_store import PLAN_COLUMNS

Row = dict[str, Any]
_ARROW = {"str": pa.string(), "int64": pa.int64(), "float64": pa.float64(), "bool": pa.bool_()}
_STATES = pa.schema(
    [
        *((name, pa.int32()) for name in ("episode", "step")),
        ("time_s", pa.float64()),
        *((name, pa.string()) for name in ("agent", "class")),
        *((name, pa.float64()) for name in ("length_m", "width_m", "x_m", "y_m", "yaw_rad", "speed_mps")),
        ("controller", pa.string()),
        ("is_target", pa.bool_()),
    ]
)


def episode(number: int, **values: Any) -> Row:
    """Return an uneventful row of ``episodes.parquet`` with *values* put in."""
    zeros = {name: 0 for name, column in EPISODE_COLUMNS.items() if column.dtype == "int64"}
    plain = dict.fromkeys(EPISODE_COLUMNS) | zeros
    plain |= {"episode": number, "scene": f"scene-{number}", "seed": 7, "end": "horizon", "duration_s": 3.0}
    plain |= {"target_collision": False, "route_completed": False, "distance_m": 30.0}
    assert values.keys() <= plain.keys()
    return plain | values


def struck(number: int, partner: str = "bv", **values: Any) -> Row:
    """Return a row of an episode whose target was hit at 3 s at (115, 101)."""
    hit = {
        "end": "collision",
        "target_collision": True,
        "collision_time_s": 3.0,
        "collision_partner": partner,
    }
    hit |= {
        "collision_type": "rear_end_striking",
        "at_fault": "target",
        "fault_reason": "It drove into the rear.",
    }
    hit |= {
        "impact_x_m": 115.0,
        "impact_y_m": 101.0,
        "relative_speed_mps": 15.8,
        "closing_speed_mps": 5.0,
        "min_clearance_m": 0.0,
    }
    return episode(number, **hit | values)


def drive(
    number: int, agent: str, x0: float, y0: float, speed: float, *, target: bool = False, steps: int = 31
) -> list[Row]:
    """Return states of a car that goes east at constant speed for *steps* instants of 0.1 s."""
    return [
        {
            "episode": number,
            "step": k,
            "time_s": round(0.1 * k, 6),
            "agent": agent,
            "class": "car",
            "length_m": 5.0,
            "width_m": 2.0,
            "x_m": x0 + 0.1 * k * speed,
            "y_m": y0,
            "yaw_rad": 0.0,
            "speed_mps": speed,
            "controller": "sumo",
            "is_target": target,
        }
        for k in range(steps)
    ]


def plan(
    number: int, agent: str, made_s: float, points: Sequence[tuple[float, float]], dt_s: float = 0.5
) -> list[Row]:
    """Return the rows of one plan, whose first point is one *dt_s* ahead."""
    return [
        {
            "episode": number,
            "made_s": made_s,
            "agent": agent,
            "time_s": made_s + dt_s * (k + 1),
            "x_m": x,
            "y_m": y,
        }
        for k, (x, y) in enumerate(points)
    ]


def write_more(folder: Path, plans: Sequence[Row], unattacked: Sequence[Row] = ()) -> None:
    """Put what was planned, and what happens without attack, beside the other tables."""
    schema = pa.schema([(name, _ARROW[column.dtype]) for name, column in PLAN_COLUMNS.items()])
    pq.write_table(pa.Table.from_pylist(list(plans), schema=schema), folder / "plans.parquet")
    schema = pa.schema([field for field in _STATES if field.name != "controller"])
    pq.write_table(pa.Table.from_pylist(list(unattacked), schema=schema), folder / "unattacked.parquet")


def write_folder(
    folder: Path,
    episodes: Sequence[Row],
    states: Sequence[Row] = (),
    collisions: Sequence[Row] = (),
    options: Mapping[str, Any] | None = None,
) -> Path:
    """Write a run folder of these rows and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    base = {
        "net": "/nowhere/lost.net.xml",
        "target": "IDM",
        "background": "replay",
        "horizon_s": 20.0,
        "seed": 3,
    }
    settings = {
        "run": {"advdiff_sumo": "0.1.0"},
        "options": base | {"episodes": len(episodes)} | dict(options or {}),
    }
    (folder / "run.toml").write_text(tomli_w.dumps(settings), encoding="utf-8")
    for name, columns, rows in (
        ("episodes", EPISODE_COLUMNS, episodes),
        ("collisions", COLLISION_COLUMNS, collisions),
    ):
        schema = pa.schema([(key, _ARROW[column.dtype]) for key, column in columns.items()])
        pq.write_table(pa.Table.from_pylist(list(rows), schema=schema), folder / f"{name}.parquet")
    pq.write_table(pa.Table.from_pylist(list(states), schema=_STATES), folder / "states.parquet")
    return folder


@dataclass
class Maker:
    """Makes folders below a temporary one."""

    root: Path
    made: int = field(default=0)

    def __call__(self, *args: Any, **kwargs: Any) -> Path:
        self.made += 1
        return write_folder(self.root / f"run-{self.made}", *args, **kwargs)


@pytest.fixture
def make_folder(tmp_path: Path) -> Callable[..., Path]:
    return Maker(tmp_path)


@pytest.fixture
def two_episodes(make_folder: Callable[..., Path]) -> Path:
    """Return a folder of a quiet episode 0 and of episode 1 with a collision of "ego" and "bv"."""
    states = drive(0, "ego", 100.0, 100.0, 10.0, target=True) + drive(0, "bv", 100.0, 110.0, 10.0)
    states += drive(1, "ego", 85.0, 101.0, 10.0, target=True) + drive(1, "bv", 105.0, 101.0, 5.0)
    collisions = [
        dict.fromkeys(COLLISION_COLUMNS)
        | {"episode": 1, "time_s": 3.0, "first": "ego", "second": "bv", "with_target": True, "initial": False}
        | {"type": "rear_end_striking", "first_speed_mps": 10.0, "impact_x_m": 115.0, "impact_y_m": 101.0}
    ]
    quiet = episode(0, min_ttc_s=4.25, min_clearance_m=8.0, min_clearance_partner="bv", brake_max_mps2=-0.0)
    return make_folder([quiet, struck(1)], states, collisions)


@dataclass(frozen=True)
class Rows:
    """The makers of rows, for tests that need other ones."""

    episode: Callable[..., Row]
    struck: Callable[..., Row]
    drive: Callable[..., list[Row]]


@pytest.fixture
def rows() -> Rows:
    return Rows(episode, struck, drive)


def job(row: Row, target: str, background: str, scene: str, net: str = "downtown") -> Row:
    """Return an episode's row with what a sweep tells of it."""
    own = {"key": f"{row['episode']:024d}", "scene_key": scene, "net": net, "attack": background}
    own |= {"target": target, "target_options": "{}", "background": background, "background_options": "{}"}
    return {**row, **own, "root_seed": 0}


_GRID = {"nets": [{"net": "downtown"}], "targets": [{"name": "IDM"}], "backgrounds": [{"name": "sumo"}]}


def write_sweep(folder: Path, episodes: Sequence[Row], states: Sequence[Row]) -> Path:
    """Write the folder of a sweep of these rows (see :func:`job`) and return it."""
    write_folder(folder, [{k: row[k] for k in EPISODE_COLUMNS} for row in episodes], states)
    (folder / "run.toml").unlink()
    settings = {"sweep": {"episodes": 2, "horizon_s": 20.0, "grid": _GRID}}
    (folder / "sweep.toml").write_text(tomli_w.dumps(settings), encoding="utf-8")
    plain = pq.read_table(folder / "episodes.parquet")
    for name in episodes[0].keys() - EPISODE_COLUMNS.keys():
        plain = plain.append_column(name, pa.array([row[name] for row in episodes]))
    pq.write_table(plain, folder / "episodes.parquet")
    return folder


def moved(rows: list[Row]) -> list[Row]:
    """Return the states of a vehicle that the policy moves."""
    return [{**row, "controller": "policy"} for row in rows]


@pytest.fixture(scope="session")
def sweep_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a sweep of two targets in two backgrounds: one collision, one failure before the first instant.

    Episodes 0 (IDM, sumo) and 1 (IDM, replay, collision with "bv", which goes elsewhere than in 0) start in the
    same seed scene; 2 (lane_graph, sumo) failed, 3 (lane_graph, replay) is quiet. All in the shipped downtown.
    """
    x, y = 420.0, 410.0
    episodes = [
        job(episode(0, min_ttc_s=4.25, min_clearance_m=8.0, min_clearance_partner="bv"), "IDM", "sumo", "a"),
        job(struck(1, impact_x_m=x + 15.0, impact_y_m=y), "IDM", "replay", "a"),
        job(episode(2, end="failed", failure_kind="plan_refused"), "lane_graph", "sumo", "a"),
        job(episode(3, min_ttc_s=1.5, min_clearance_m=2.0), "lane_graph", "replay", "a"),
    ]
    states = drive(0, "ego", x - 15.0, y, 10.0, target=True) + drive(0, "bv", x - 15.0, y + 9.0, 10.0)
    states += drive(1, "ego", x - 15.0, y, 10.0, target=True) + moved(drive(1, "bv", x + 5.0, y, 5.0))
    states += drive(3, "ego", x - 40.0, y, 12.0, target=True) + moved(drive(3, "bv", x, y + 4.0, 3.0))
    folder = write_sweep(tmp_path_factory.mktemp("sweep") / "planners", episodes, states)
    plans: list[Row] = []
    for made in (0.0, 0.5, 1.0, 1.5, 2.0, 2.5):  # "bv" of episode 1 means to swerve to the north
        ahead = x + 5.0 + 5.0 * made
        plans += plan(1, "bv", made, [(ahead + 2.5 * (k + 1), y + 1.0 * (k + 1)) for k in range(6)])
    write_more(folder, plans, drive(3, "ego", x - 40.0, y, 8.0, target=True))
    return folder
