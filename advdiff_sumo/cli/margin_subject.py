"""What a margin is about: an episode of a run or sweep, or a seed scene described by options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from advdiff_sumo.cli.replay import original_episode
from advdiff_sumo.config import read_toml
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.experiments.margin import BRAKING, EVERY_ATTACK, SCALES
from advdiff_sumo.metrics.archive import NATURAL
from advdiff_sumo.traffic.manoeuvres.intensity import BRAKING_KINDS

if TYPE_CHECKING:
    from advdiff_sumo.sweep.repeat import Before

DEFAULT_ATTACK = "hard-stop"
_WITH_SEVERITY = ("scripted", "diffusion")
"""Backgrounds with options that prescribe a severity."""


@dataclass(frozen=True)
class MarginSubject:
    """The seed scene of a margin, and what is known of target and attack.

    Attributes:
        number: which of the seed's scenes it is.
        attack: kind of attack.
        base: options of the episode that it is about; empty without one.
        name: name of that episode, for folders.
        source: words of the command line that name it; empty without one.
        asked_attack: the background's option ``attack`` in that episode, which stays: the same encounter is then tried;
            None: the attack was named on the command line.
    """

    number: int
    attack: str
    base: Mapping[str, Any] = field(default_factory=dict)
    name: str = ""
    source: tuple[str, ...] = ()
    asked_attack: str | None = None

    @property
    def default_scale(self) -> str | None:
        """The scale that is varied if none is given; None: the first of the attack.

        Braking leaves the encounter as it was up to then.
        """
        return BRAKING.by if self.asked_attack is not None and self.attack in BRAKING_KINDS else None


def described_subject(
    number: int | None, config: Path | None, attack: str | None, folder: Path | None
) -> MarginSubject:
    """Return the subject for options of the command line and of the file *config*.

    Args:
        number: that of ``--number``; None: that of the episode that *config* repeats, or 0.
        config: file of a run's options, which ``replay`` writes for one episode, too.
        attack: that of ``--attack``.
        folder: that of ``--run`` or ``--sweep``.

    Raises:
        FileError: the file cannot be read.
        ConfigError: a folder is given, but no episode of it.
    """
    if folder is not None:
        raise ConfigError(f"{folder}: name an episode of it, too: its key or number, as for replay")
    header = {} if config is None else read_toml(config).get("run", {})
    repeated = header.get("repeats") if isinstance(header, dict) else None
    if number is None:
        number = repeated if isinstance(repeated, int) else 0
    return MarginSubject(number, attack or DEFAULT_ATTACK)


def episode_subject(
    key: str, run: Path | None, sweep: Path | None, attack: str | None, given: Mapping[str, Any]
) -> MarginSubject:
    """Return the subject that is episode *key* of the folder *run* or *sweep*.

    Args:
        key: key of the episode, or its number.
        run: folder of a run.
        sweep: folder of a sweep; if both are None, the one in ``runs/`` that has the episode is meant.
        attack: that of ``--attack``; None: the attack of the episode.
        given: values of the options that may be given by flag → value; None: not given.

    Raises:
        InputError: there is no such episode, an option contradicts it, or its attack has no severity.
    """
    for flag in ("--net", "--demand", "--seed", "--number", "--config"):
        if given[flag] is not None:
            raise ConfigError(
                f"{flag}: the seed scene is that of episode {key}; leave {flag} or the episode out"
            )
    original = original_episode(key, run, sweep)
    options = original.plan.options(original.job)
    base = options.model_dump(exclude={"episodes"})
    asked: str | None = None
    if options.background not in _WITH_SEVERITY:
        base |= {"background": "scripted", "background_options": {"attackers": 1}}
    elif attack is None:
        asked = str(options.background_options.get("attack", "any"))
    if given["--target"] is not None:
        base["target_options"] = {}
    folder = ("--run", str(run.resolve())) if run else ("--sweep", str(original.store.path.resolve()))
    kind = attack or _attack_of(original, key)
    return MarginSubject(original.job.number, kind, base, original.name, (key, *folder), asked)


def _attack_of(original: Before, key: str) -> str:
    """Return the kind of attack in an episode.

    Raises:
        ConfigError: nobody attacked, or the severity of that kind cannot be varied.
    """
    requested = original.plan.options(original.job).background_options.get("attack")
    rows = original.part.tables["episodes"].to_pylist() if original.part and original.part.tables else []
    (manoeuvre,) = [row.get("attacker_manoeuvre", "") for row in rows] or [""]
    for kind in (requested, manoeuvre):
        if kind in SCALES:
            return str(kind)
    if manoeuvre in ("", None, NATURAL):
        reason = "it does not say what was done against the target"
    else:
        reason = f"{manoeuvre} has no severity that can be varied"
    raise ConfigError(f"episode {key}: {reason}; choose an --attack: {', '.join((*SCALES, EVERY_ATTACK))}")
