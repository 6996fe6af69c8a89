"""Options that the training commands have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

Data: TypeAlias = Annotated[
    list[Path], typer.Option(help="Window file, or a folder of them; may be given several times.")
]
Device: TypeAlias = Annotated[str, typer.Option(help="auto, cpu or cuda.")]
Threads: TypeAlias = Annotated[int | None, typer.Option(min=1, help="CPU threads.", show_default="all")]
Resume: TypeAlias = Annotated[bool, typer.Option("--resume", help="Go on with the training in --out.")]


def use_threads(threads: int | None) -> None:
    """Let PyTorch use *threads* CPU threads; None: all."""
    import torch  # late: --help needs no PyTorch

    if threads is not None:
        torch.set_num_threads(threads)
