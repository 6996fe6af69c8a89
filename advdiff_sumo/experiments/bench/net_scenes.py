"""Seed scenes of a bench on the user's own nets, as ``advdiff-sumo run`` finds them there."""

from __future__ import annotations

from pathlib import Path

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.experiments.bench.bench_config import Request
from advdiff_sumo.experiments.bench.log_scenes import bench_scenes
from advdiff_sumo.experiments.bench.scene_list import SceneList, make_list
from advdiff_sumo.maps.shipped_nets import net_name

_OF_A_LIST = ("background_options",)
"""Options that do not decide where a list's scenes begin."""


def asked_scenes(request: Request, name: str, folder: Path | None) -> SceneList:
    """Return the seed scenes that the request asks for: of nets, of a list, or of a driving log.

    Args:
        request: what is asked.
        name: shipped list that a number without nets is of.
        folder: of the bench, as :func:`bench_scenes` takes it.

    Raises:
        InputError: there is no such net, list or log, both nets and a list are given, or an option is impossible.
    """
    own = request.episode
    if request.nets:
        return _scenes_of_nets(request)
    others = sorted(own.model_fields_set - {*_OF_A_LIST})
    if others:
        raise ConfigError(f"--set {others[0]}: a list has its own; add --net, or leave it out")
    return bench_scenes(request.scenes, name, folder)


def _scenes_of_nets(request: Request) -> SceneList:
    """Return the first ``request.scenes`` of the nets in turn; of one net scenes 0, 1, … of a run with that seed."""
    if not request.scenes.isdigit():
        raise ConfigError(
            f"--scenes {request.scenes}: has its own nets; give the number of scenes on --net, or leave --net out "
            "(a folder goes on with what it was begun with; another --out begins anew)"
        )
    count = int(request.scenes)
    if count < 1:
        raise ConfigError(f"--scenes {count}: give a number above 0")
    nets = tuple(dict.fromkeys(net_name(net) for net in request.nets))
    own = request.episode
    each = -(-count // len(nets))
    whole = make_list(each, own.seed, "the first seed scenes of own nets", nets, own.scene, request.horizon_s)
    return whole.model_copy(update={"demand": own.demand}).first(count)
