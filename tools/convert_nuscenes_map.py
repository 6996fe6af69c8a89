"""Convert a nuScenes map into a SUMO net: ``python tools/convert_nuscenes_map.py MAP.json -o networks/b.net.xml``.

The same as ``advdiff-sumo convert``, for a checkout that is not installed.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import typer

from advdiff_sumo.cli.convert import convert
from advdiff_sumo.core.errors import InputError


def main() -> int:
    """Run the converter and return the exit code; an error in the input is one sentence and exit code 2."""
    try:
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        app.command()(convert)
        app()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
