"""The traffic VAE: context encoder, posterior and decoder, trained together (Sec. III-B, ELBO)."""

from __future__ import annotations

from torch import nn

from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder
from advdiff_sumo.models.context import ContextEncoder
from advdiff_sumo.models.decoder import Decoder
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.posterior import Posterior


class TrafficModel(nn.Module):
    """Three networks that share one set of options.

    Attributes:
        options: their sizes.
        encoder: (map, past) → h and prior of z.
        posterior: (future, h) → q(z | τ, h).
        decoder: (z, h) → joint futures.
    """

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        self.options = options
        self.encoder = ContextEncoder(options)
        self.posterior = Posterior(options)
        self.decoder = make_decoder(options)


def make_decoder(options: ModelOptions) -> Decoder:
    """Return an untrained decoder of the kind that *options* name."""
    return ClosedLoopDecoder(options) if options.decoder == "closed-loop" else Decoder(options)
