"""The rivals from the command line, with small untrained networks."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from advdiff_sumo.models.bundle import BundleOptions, new_bundle, save_bundle
from advdiff_sumo.models.simnet import new_simnet, save_simnet
from tests.e2e.commands import SAME_BYTES, TINY, advdiff
from tests.e2e.test_diffusion import MODEL


@pytest.mark.slow
@pytest.mark.parametrize("name", ["strive", "advsim"])
def test_five_seconds_are_repeatable(name: str, tmp_path: Path) -> None:
    bundle = new_bundle(BundleOptions.parse({"model": MODEL}))
    save_bundle(bundle, tmp_path / "small.safetensors", ())
    save_simnet(new_simnet(bundle.options.model), tmp_path / "simnet.safetensors")
    words = ["run", "--background", name, "--net", "motorway", "--episodes", "1", *TINY[2:], "--horizon", "5"]
    words += ["--target", "lane_graph", "--seed", "3", "--weights", "small.safetensors"]
    words += ["--set", "background_options.rounds=4"]
    if name == "advsim":
        words += ["--set", f"background_options.simnet={tmp_path / 'simnet.safetensors'}"]
    done = advdiff(*words, "--out", "first", cwd=tmp_path)
    assert done.code == 0, done.err
    (row,) = pq.read_table(tmp_path / "first" / "episodes.parquet").to_pylist()
    assert row["end"] != "failed"
    states = pq.read_table(tmp_path / "first" / "states.parquet")
    assert "policy" in states["controller"].to_pylist()
    again = advdiff("run", "--config", "first/run.toml", "--out", "again", cwd=tmp_path, hash_seed=1)
    assert again.code == 0, again.err
    for table in SAME_BYTES:
        assert (tmp_path / "first" / table).read_bytes() == (tmp_path / "again" / table).read_bytes()
