"""SimNet: every vehicle's next action from what it sees now, one step at a time.

After Bergamini et al. 2021, "SimNet: Learning reactive self-driving simulations from real-world observations"
(doi:10.1109/ICRA48506.2021.9561666). Theirs sees a raster around each agent; this one sees through the context
encoder of the traffic model, so that the two differ in what they learn and not in what they look at. There is no
latent and nothing is drawn: the same scene gives the same future.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from advdiff_sumo.models.advance import advance
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.context import ContextEncoder
from advdiff_sumo.models.decoder import Forced, Rollout, rollout_of
from advdiff_sumo.models.model_options import FUTURE_STEPS, MODEL_STEP_S, ModelOptions
from advdiff_sumo.models.tensor_bicycle import controls, step

_MOTION = 2


class SimNet(nn.Module):
    """Context encoder and a head that gives each vehicle an acceleration and a curvature for half a second.

    Attributes:
        options: sizes of the networks and the limits of the actions.
        encoder: (map, past) → h; its prior over latents is not used.
        head: (h, speed, size) → two unbounded numbers.
    """

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        self.options = options
        width = options.hidden
        self.encoder = ContextEncoder(options)
        self.encoder.prior.requires_grad_(False)
        self.head = nn.Sequential(
            nn.Linear(width + _MOTION, width),
            nn.ReLU(),
            nn.Linear(width, width),
            nn.ReLU(),
            nn.Linear(width, 2),
        )

    def act(self, batch: SceneBatch) -> tuple[Tensor, Tensor]:
        """Return acceleration in m/s² and curvature in 1/m, (B, A) each, for the next half second; 0 for walkers."""
        speed, length = batch.pose[..., 3].clamp(min=0.0), batch.size[..., 0]
        motion = torch.stack((0.1 * speed, 0.1 * length), dim=-1)
        raw = self.head(torch.cat((self.encoder(batch).h, motion), dim=-1))
        accel, curvature = controls(raw, speed, length, self.options)
        return accel * batch.moved, curvature * batch.moved

    def forward(self, batch: SceneBatch, steps: int = FUTURE_STEPS, forced: Forced | None = None) -> Rollout:
        """Return the joint future: act, drive half a second, look again, and so on.

        The map pieces stay those around the present positions (see ``models.advance``); signals keep their state.

        Args:
            batch: the scenes.
            steps: how often to act.
            forced: agents whose future is given, such as a target; the others see it.
        """
        states = []
        for k in range(steps):
            accel, curvature = self.act(batch)
            pose = batch.pose
            xy, yaw, speed = step(
                pose[..., :2], pose[..., 2], pose[..., 3].clamp(min=0.0), accel, curvature, MODEL_STEP_S
            )
            if forced is not None:
                xy, yaw, speed = forced.applied(k, xy, yaw, speed)
            states.append((xy, yaw, speed, accel, curvature))
            if k + 1 < steps:
                now = Rollout(*(column[:, :, None] for column in states[-1]))
                batch = advance(batch, now, 1)
        return rollout_of(states)

    def controls(self, batch: SceneBatch, steps: int = FUTURE_STEPS) -> tuple[Tensor, Tensor]:
        """Return accelerations in m/s² and curvatures in 1/m, (B, A, T) each, that :meth:`forward` drives."""
        rollout: Rollout = self(batch, steps)
        return rollout.accel, rollout.curvature
