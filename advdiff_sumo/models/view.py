"""The networks' view of a scene: the road users near the target, ordered by distance, as one batch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, IntArray
from advdiff_sumo.core.errors import SceneError
from advdiff_sumo.core.map_view import MapView
from advdiff_sumo.core.scene import AgentClass, Scene, Tracks
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.collate import scene_batch
from advdiff_sumo.models.model_options import HISTORY_STEPS, MODEL_STEP_S

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap  # needs SUMO's library, which training does not

MOST_AGENTS = 32
"""Most road users in a view, unless more of them get a plan."""


@dataclass(frozen=True)
class View:
    """A scene as the networks see it; A agents, the target first.

    Attributes:
        scene: the whole scene.
        rows: (A,) the agents' rows in the scene.
        moved: (A,) which agents get a plan.
        batch: the agents as a batch of one scene.
        now: histories of the agents.
    """

    scene: Scene
    rows: IntArray
    moved: BoolArray
    batch: SceneBatch
    now: Tracks

    @property
    def ids(self) -> tuple[str, ...]:
        """Names of the agents."""
        return self.now.ids


def look(
    road: RoadMap,
    scene: Scene,
    left_out: BoolArray | None = None,
    most: int = MOST_AGENTS,
    map_view: MapView = "near",
) -> View:
    """Return the networks' view of *scene*.

    Args:
        road: the map.
        scene: with a history at the model's time step.
        left_out: (agents,) movable vehicles that get no plan, although they are in the view.
        most: number of road users in the view, unless more of them get a plan.
        map_view: how much of the map each agent sees.

    Raises:
        SceneError: the history has another time step.
    """
    if abs(scene.history.dt_s - MODEL_STEP_S) >= 1e-9:
        raise SceneError(
            f"the trained networks need histories every {MODEL_STEP_S:g} s, "
            f"not every {scene.history.dt_s:g} s: leave sim.model_step_s at its default"
        )
    moved = scene.movable & (scene.history.classes != AgentClass.PEDESTRIAN) & scene.history.valid[:, -1]
    moved[scene.target] = False
    if left_out is not None:
        moved &= ~left_out
    rows = _nearest(scene, moved, most)
    history = scene.history.rows(rows)
    lacking = HISTORY_STEPS - history.steps  # earlier instants are marked as unknown
    history = history.padded(lacking) if lacking > 0 else history.window(-lacking, history.steps)
    table = road.pieces(map_view)
    near = table.rows_near(history.xy_m[:, -1], history.yaw_rad[:, -1], history.speed_mps[:, -1])
    states = table.signal_states(scene.signals)
    batch = scene_batch(
        history, table.xy_m, table.features, table.signal, near.astype(np.int64), states.astype(np.int64)
    )
    return View(scene, rows, moved[rows], batch, history)


def _nearest(scene: Scene, moved: BoolArray, most: int) -> IntArray:
    """Return rows of the target, all *moved* and the nearest others, *most* in all, ordered by distance."""
    now = scene.history.xy_m[:, -1]
    gap = np.where(scene.history.valid[:, -1], np.hypot(*(now - now[scene.target]).T), np.inf)
    gap[scene.target] = -1.0
    is_included = moved.copy()
    is_included[scene.target] = True
    order = np.lexsort((np.arange(len(gap)), gap, ~is_included))
    count = max(most, int(is_included.sum()))
    picked = order[:count]
    picked = picked[np.isfinite(gap[picked])]
    return np.asarray(picked[np.lexsort((picked, gap[picked]))], dtype=np.int64)
