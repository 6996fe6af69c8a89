"""The choice among several samples."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.view import look
from advdiff_sumo.traffic.diffusion.draw import most_plausible


@pytest.mark.parametrize(
    ("touches", "attackers", "chosen"),
    [
        (("v1", "v0"), ("v1",), 0),  # the attack itself
        (("v1", "v0"), (), 1),
        (("v1", "v0"), ("v2",), 1),
        (("v1", "v2"), ("v1",), 1),
    ],
)
def test_an_attacker_may_touch_only_the_target(
    touches: tuple[str, str],
    attackers: tuple[str, ...],
    chosen: int,
    downtown: RoadMap,
    street: Callable[..., Scene],
) -> None:
    """Two samples of three vehicles 15 m apart, equal except that two vehicles touch in the first one."""
    view = look(downtown, street([(60.0, 0.0), (75.0, 0.0), (45.0, 0.0)], [8.0] * 3))
    batch = view.batch.repeat(2)
    x, y, yaw, speed = (value[..., None].repeat(1, 1, 12) for value in batch.pose.unbind(-1))
    along = 0.5 * torch.arange(1.0, 13.0) * speed
    xy = torch.stack((x + torch.cos(yaw) * along, y + torch.sin(yaw) * along), dim=-1)
    one, other = map(view.ids.index, touches)
    xy[0, one] = xy[0, other]
    rollout = Rollout(xy, yaw, speed, torch.zeros_like(x), torch.zeros_like(x))
    assert most_plausible(rollout, batch, [view.ids.index(name) for name in attackers]) == chosen
