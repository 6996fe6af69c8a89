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
"""How many of the pieces that an agent sees are lanes."""
GROUPS = 8
"""Groups of the denoiser's group normalisation."""
PIECE_FEATURES = 13
"""Columns of a map piece: ten of the map table, then one-hot red, yellow, green."""


class ModelOptions(Options):
    """Sizes of every network; a checkpoint carries them.

    Attributes:
        hidden: width D of the state embedding h.
        latent: numbers Z of a vehicle's latent z; 32 in the paper's implementation here.
        edge: width of the relative-pose embedding in interaction nets.
        message: width of the messages between agents.
        heads: attention heads of the map pooling and of the interaction nets.
        interaction_layers: fully connected graph layers of encoder, posterior and reward model (two in Sec. III-B).
        decoder: "open": it knows the map from the context alone; "closed-loop": it looks at lanes, road edge and
            bodies again at each of its steps, see ``models.closed_loop_decoder``.
        decoder_layers: graph layers at each of the decoder's steps.
        neighbours: agents, itself among them, that each vehicle looks at in a step of the closed-loop decoder, the
            nearest ones; 0: all.
        map_view: how much of the map each vehicle sees: "near": 60 m around; "far": what it may drive in 6 s, too.
        denoiser_layers: graph layers through which vehicles see each other's noisy latents; 0: each on its own.
        denoiser_situation: tell the denoiser outright of lights, vehicles ahead and limits, see
            ``models.driving_situation``.
        channels: channels of the denoiser's U-Net at full, half and quarter length.
        reward_hidden: width of the reward model.
        accel_mps2: strongest acceleration that the decoder can give.
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
        """Refuse widths that heads or groups do not divide."""
        for name in ("hidden", "message", "reward_hidden"):
            if getattr(self, name) % self.heads:
                raise ValueError(f"{name} = {getattr(self, name)} is no multiple of heads = {self.heads}")
        if any(channels < GROUPS or channels % GROUPS for channels in self.channels):
            raise ValueError(f"channels {self.channels} must be multiples of {GROUPS}")
        return self
