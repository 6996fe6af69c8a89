"""The traffic VAE: context encoder, posterior and decoder, trained together (Sec. III-B, ELBO)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder
from advdiff_sumo.models.context import STATE, ContextEncoder, gaussian_head, seen_states
from advdiff_sumo.models.decoder import Decoder
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.geometry import relative_features
from advdiff_sumo.models.interaction import InteractionNet
from advdiff_sumo.models.model_options import FUTURE_STEPS, ModelOptions
from advdiff_sumo.models.perceptron import perceptron


class Posterior(nn.Module):
    """q(z | τ, h), the latent given the recorded future τ: the encoder's structure over past and future."""

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        width = options.hidden
        self.future = perceptron(width + FUTURE_STEPS * STATE, width, width)
        self.norm = nn.LayerNorm(width)
        self.interaction = InteractionNet(width, options)
        self.head = nn.Linear(width, 2 * options.latent)

    def forward(self, batch: SceneBatch, h: Tensor) -> Gaussian:
        """Return q(z | τ, h), (B, A, Z)."""
        pose = batch.pose
        future = seen_states(batch.future, batch.future_valid, pose, 0.05)
        features = self.future(torch.cat((h, future), dim=-1))
        relative = relative_features(pose[..., :2], pose[..., 2], pose[..., 3])
        mixed = self.interaction(self.norm(h + features), relative, batch.present)
        return gaussian_head(self.head(mixed))


class TrafficModel(nn.Module):
    """Encoder, posterior and decoder with the same options.

    Attributes:
        options: sizes of the networks.
        encoder: (map, past) → h and prior of z.
        posterior: (future, h) → q(z | τ, h).
        decoder: (z, h) → joint futures.
    """

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        self.options = options
        self.encoder = ContextEncoder(options)
        self.posterior = Posterior(options)
        kind = ClosedLoopDecoder if options.decoder == "closed-loop" else Decoder
        self.decoder: Decoder = kind(options)
