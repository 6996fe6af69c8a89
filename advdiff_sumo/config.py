"""Base of all option models: strict, frozen, and a misspelt key gets a suggestion."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from advdiff_sumo.core.errors import ConfigError, FileError, did_you_mean


class Options(BaseModel):
    """Immutable options; unknown keys are refused, never ignored."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def parse(cls, values: Mapping[str, Any], where: str = "options") -> Self:
        """Validate *values*.

        Args:
            values: nested plain dictionary.
            where: what the values came from, for the message.

        Raises:
            ConfigError: one sentence that names the key, the value and the remedy.
        """
        try:
            return cls.model_validate(dict(values))
        except ValidationError as error:
            raise ConfigError(f"{where}: {_sentence(cls, error)}") from None


def _sentence(model: type[BaseModel], error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    key = ".".join(str(part) for part in first["loc"]) or "value"
    if first["type"] == "extra_forbidden":
        return f"no option '{key}'; {did_you_mean(str(first['loc'][-1]), _known(model, first['loc'][:-1]))}"
    if first["type"] == "missing":
        return f"option '{key}' is missing"
    message = first["msg"].removeprefix("Value error, ")
    return f"{key} = {first['input']!r}: {message[0].lower()}{message[1:]}"


def _known(model: type[BaseModel], path: tuple[int | str, ...]) -> list[str]:
    for part in path:
        info = model.model_fields.get(str(part))
        inner = info.annotation if info else None
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            break
        model = inner
    return list(model.model_fields)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        FileError: the file is missing or malformed; the message has line and column.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FileError(path, f"not valid TOML ({error})", "correct that line") from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror})") from None


def set_dotted(values: dict[str, Any], assignment: str) -> None:
    """Apply one ``a.b=c`` of ``--set`` to nested *values*, in place; c is read as a TOML value, else as text.

    Raises:
        ConfigError: there is no "=" in it, or a part of the path holds a plain value.
    """
    path, equals, text = assignment.partition("=")
    if not equals or not path.strip():
        raise ConfigError(f"--set {assignment}: expected NAME=VALUE, for example --set sim.step_s=0.1")
    *parents, leaf = path.strip().split(".")
    node = values
    for parent in parents:
        node = node.setdefault(parent, {})
        if not isinstance(node, dict):
            raise ConfigError(f"--set {assignment}: '{parent}' is not a group of options")
    node[leaf] = _toml_value(text.strip())


def _toml_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
