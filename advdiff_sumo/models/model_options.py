"""Sizes of the networks and the physical bounds of the decoder."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from advdiff_sumo.config import Options
from advdiff_sumo.core.map_view import MAP_PIECES, MapView

HISTORY_STEPS = 5
"""Instants of past, 2 s at 2 Hz with now as the last."""
FUTURE_STEPS = 12
"""Instants of future, 6 s at 2 Hz."""
MODEL_STEP_S = 0.5
CLASSES = 6
PIECE_POINTS = 6
LANES_OF = {lanes + edges: lanes for lanes, edges in MAP_PIECES.values()}
"""Number of an agent's map pieces → number of lanes among them."""
GROUPS = 8
"""Groups of the denoiser's group normalisation."""
PIECE_FEATURES = 13
"""Features of a map piece: ten of the map table, then one-hot red, yellow, green."""


class ModelOptions(Options):
    """Sizes of all networks; stored in checkpoints.

    Attributes:
        hidden: width D of the state embedding h.
        latent: dimensions Z of a vehicle's latent z.
        edge: width of the relative-pose embedding in interaction nets.
        message: width of the messages between agents.
        heads: attention heads of the map pooling and of the interaction nets.
        interaction_layers: fully connected graph layers of encoder, posterior and reward model (two in Sec. III-B).
        decoder: "open": knows the map only through the context; "closed-loop": observes lanes, road edges and
            neighbours anew at each of its steps, see ``models.closed_loop_decoder``.
        decoder_layers: graph layers at each of the decoder's steps.
        neighbours: how many of the nearest agents, itself included, each vehicle observes in a step of the closed-loop
            decoder; 0: all.
        map_view: how much of the map each vehicle sees: "near": 60 m around it; "far": also what it can reach in 6 s.
        denoiser_layers: graph layers between the vehicles' noisy latents; 0: each vehicle is denoised on its own.
        denoiser_situation: give the denoiser features of signals, lead vehicles and speed limits, see
            ``models.driving_situation``.
        channels: channels of the denoiser's U-Net at full, half and quarter length.
        reward_hidden: width of the reward model.
        accel_mps2: strongest acceleration of the decoder.
        brake_mps2: strongest deceleration.
        lateral_mps2: strongest lateral acceleration.
        steer_rad: largest front-wheel angle.
    """

    hidden: int = Field(128, ge=8, le=1024, multiple_of=4)
    latent: int = Field(32, ge=4, le=256, multiple_of=4)
    edge: int = Field(32, ge=4, le=512)
    message: int = Field(64, ge=4, le=1024, multiple_of=4)
    heads: int = Field(4, ge=1, le=16)
    interaction_layers: int = Field(2, ge=1, le=6)
    decoder: Literal["open", "closed-loop"] = "open"
    decoder_layers: int = Field(1, ge=1, le=6)
    neighbours: int = Field(0, ge=0)
    map_view: MapView = "near"
    denoiser_layers: int = Field(1, ge=0, le=6)
    denoiser_situation: bool = False
    channels: tuple[int, int, int] = (24, 32, 48)
    reward_hidden: int = Field(64, ge=8, le=1024, multiple_of=4)
    accel_mps2: float = Field(4.0, gt=0.0)
    brake_mps2: float = Field(8.0, gt=0.0)
    lateral_mps2: float = Field(6.0, gt=0.0)
    steer_rad: float = Field(0.6, gt=0.0, lt=1.5)

    @model_validator(mode="after")
    def _fit(self) -> Self:
        """Refuse widths that are not divisible by the number of heads or groups."""
        for name in ("hidden", "message", "reward_hidden"):
            if getattr(self, name) % self.heads:
                raise ValueError(f"{name} = {getattr(self, name)} is no multiple of heads = {self.heads}")
        if any(channels < GROUPS or channels % GROUPS for channels in self.channels):
            raise ValueError(f"channels {self.channels} must be multiples of {GROUPS}")
        return self
