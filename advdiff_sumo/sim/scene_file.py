"""Turn seed scenes into bytes and back, to keep them and to send them to other processes and machines."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.core.scene import TRACK_ARRAYS, Tracks
from advdiff_sumo.sim.seed_scene import PlacedTraffic, SavedTraffic, SeedScene


def scene_to_bytes(scene: SeedScene) -> bytes:
    """Return *scene* as bytes, without the path of its net; the same scene gives the same bytes."""
    arrays: dict[str, Any] = {}
    meta: dict[str, Any] = {
        "name": scene.name,
        "seed": scene.seed,
        "target": scene.target,
        "routes": {name: list(route) for name, route in scene.routes.items()},
        "horizon_s": scene.horizon_s,
    }
    for prefix, tracks in (("history", scene.history), ("log", scene.log)):
        meta[prefix] = {"ids": list(tracks.ids), "t0_s": tracks.t0_s, "dt_s": tracks.dt_s}
        arrays |= {f"{prefix}.{name}": getattr(tracks, name) for name in TRACK_ARRAYS}
    if isinstance(scene.start, SavedTraffic):
        meta["start"] = {"time_s": scene.start.time_s}
        arrays["state_xml"] = _bytes(scene.start.state_xml)
        for group in ("routes", "additional"):
            contents = getattr(scene.start, group)
            meta["start"][group] = len(contents)
            arrays |= {f"{group}.{k}": _bytes(content) for k, content in enumerate(contents)}
    else:
        arrays["drivable"] = scene.start.drivable
    arrays["meta"] = _bytes(json.dumps(meta).encode())
    sink = io.BytesIO()
    np.savez_compressed(sink, **arrays)
    return sink.getvalue()


def scene_from_bytes(content: bytes, net: Path) -> SeedScene:
    """Return the scene that :func:`scene_to_bytes` made, on the net file *net*; nothing in *content* is executed."""
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        meta = json.loads(arrays["meta"].tobytes())
        return SeedScene(
            name=meta["name"],
            net=net,
            seed=meta["seed"],
            history=_tracks("history", meta, arrays),
            target=meta["target"],
            routes={name: tuple(route) for name, route in meta["routes"].items()},
            log=_tracks("log", meta, arrays),
            start=_start(meta, arrays),
            horizon_s=meta["horizon_s"],
        )


def _start(meta: Mapping[str, Any], arrays: Mapping[str, Any]) -> SavedTraffic | PlacedTraffic:
    start = meta.get("start")
    if start is None:
        return PlacedTraffic(arrays["drivable"])
    groups = (
        tuple(arrays[f"{group}.{k}"].tobytes() for k in range(start[group]))
        for group in ("routes", "additional")
    )
    return SavedTraffic(arrays["state_xml"].tobytes(), start["time_s"], *groups)


def _tracks(prefix: str, meta: Mapping[str, Any], arrays: Mapping[str, Any]) -> Tracks:
    plain = meta[prefix]
    fields = {name: arrays[f"{prefix}.{name}"] for name in TRACK_ARRAYS}
    return Tracks(ids=tuple(plain["ids"]), **fields, t0_s=plain["t0_s"], dt_s=plain["dt_s"])


def _bytes(content: bytes) -> Any:
    return np.frombuffer(content, dtype=np.uint8)
