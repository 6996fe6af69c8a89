"""Episodes on real nets in which a moved vehicle could crash SUMO."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import advdiff

SCENE = ("warmup_s=20", "scenes_per_warmup=4", "min_neighbours=1", "min_route_m=30", "density_per_km=20")


@pytest.mark.data
@pytest.mark.slow
def test_a_vehicle_that_leaves_the_road_on_a_junction_does_not_end_sumo(
    adv_data: Path, tmp_path: Path
) -> None:
    """In guided traffic, a car on the middle one of three lanes of a junction is removed from SUMO at 1.9 s."""
    source = adv_data / "nuscenes-mini" / "maps" / "expansion" / "singapore-hollandvillage.json"
    done = advdiff("convert", source, "-o", "net.net.xml", "--righthand", cwd=tmp_path)
    assert done.code == 0, done.err
    words = ("run", "--net", "net.net.xml", "--background", "diffusion", "--attack", "cut-in")
    scene = (
        word
        for text in (*SCENE, "min_speed_mps=0", "max_vehicles=400")
        for word in ("--set", f"scene.{text}")
    )
    done = advdiff(*words, *scene, "--episodes", 1, "--horizon", 3, "--out", "run", cwd=tmp_path)
    assert done.code == 0, done.out + done.err
    (row,) = pq.read_table(tmp_path / "run" / "episodes.parquet").to_pylist()
    assert (row["end"], row["failure_kind"]) == ("horizon", None)
