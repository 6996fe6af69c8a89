"""Base of all option models: strict, frozen, and a misspelt key gets a suggestion."""

from __future__ import annotations

import math
import reprlib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self, TypeAlias, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from advdiff_sumo.core.errors import ConfigError, FileError, did_you_mean, nearest, os_reason

_Own = TypeVar("_Own", bound=Mapping[str, Any])
Seed: TypeAlias = Annotated[int, Field(ge=0, lt=2**63)]
"""Root of random numbers; tables hold it in 64 bits."""


def _finite(own: _Own) -> _Own:
    """Refuse numbers that are none, which no file of results can hold, also in lists and tables."""
    for name, value in own.items():
        if not _is_finite(value):
            raise ValueError(f"{name} = {_short(value)}: give finite numbers")
    return own


def _is_finite(value: Any) -> bool:
    if isinstance(value, Mapping):
        return all(map(_is_finite, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


OwnOptions: TypeAlias = Annotated[dict[str, Any], AfterValidator(_finite)]
"""Options of a planner's or policy's own, by name."""
Variants: TypeAlias = Annotated[dict[str, tuple[Any, ...]], AfterValidator(_finite)]
"""Values to try of each of them."""

#: Two names as alike as "background" and "backgrounds" are one that was misspelt, wherever else the same one is known.
_MISSPELT = 0.85


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
    path, value = first["loc"], first["input"]
    key = _dotted(path)
    if first["type"] == "extra_forbidden":
        return f"no option '{key}'; {_remedy(model, path)}"
    if first["type"] == "missing":
        return f"option '{key}' is missing"
    if first["type"] == "model_type":
        inside = _dotted((*path, next(iter(_group(model, path).model_fields))))
        if isinstance(value, list):
            return (
                f"{key} = {_short(value)}: that is a list; a group of options belongs there, such as {inside}"
            )
        return f"{key} = {_short(value)}: that is a group of options; set one of them, such as {inside}"
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "value_error" and isinstance(
        value, Mapping
    ):  # a rule about several options names them
        return f"{key}: {message}" if key else message
    return f"{key or 'value'} = {_short(value)}: {message[0].lower()}{message[1:]}"


def _remedy(model: type[BaseModel], path: tuple[int | str, ...]) -> str:
    """Return the nearest name: one of the group that is hardly another, the same one in another group, or any."""
    same = [name for name in _leaves(model) if name.rpartition(".")[2] == str(path[-1]).rpartition(".")[2]]
    if _dotted(path) in same:
        return "write it without quotation marks: a name with a dot in quotation marks is another one"
    beside = list(_group(model, path[:-1]).model_fields)
    if same and nearest(str(path[-1]), beside, _MISSPELT) is None:
        if same == [path[-1]] and any(isinstance(part, int) for part in path):
            return f"'{path[-1]}' holds for the whole file: write it above its first [table]"
        return did_you_mean(_dotted(path), same)
    return did_you_mean(str(path[-1]), beside)


def _dotted(path: tuple[int | str, ...]) -> str:
    return ".".join(str(part) for part in path)


def _short(value: Any) -> str:
    """Return *value* as Python writes it, long ones cut, groups of options as "{...}"."""
    form = reprlib.Repr()
    form.maxdict, form.maxlist, form.maxstring, form.maxother = 0, 4, 40, 40
    return form.repr(value)


def _group(model: type[BaseModel], path: tuple[int | str, ...]) -> type[BaseModel]:
    """Return the model of the group of options at *path*, as far as there are groups."""
    for part in path:
        if isinstance(part, int):
            continue  # a place in a list of groups
        inner = _groups(model).get(part)
        if inner is None:
            break
        model = inner
    return model


def _groups(model: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """Return the fields of *model* that hold a group of options, or several of one kind."""
    kinds = {}
    for name, info in model.model_fields.items():
        for kind in (info.annotation, *get_args(info.annotation)):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                kinds[name] = kind
    return kinds


def _leaves(model: type[BaseModel]) -> list[str]:
    """Return the dotted names of all options of *model* and its groups."""
    groups = _groups(model)
    own = [name for name in model.model_fields if name not in groups]
    return own + [f"{name}.{leaf}" for name, group in groups.items() for leaf in _leaves(group)]


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        FileError: the file is missing or malformed; the message has line and column.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except UnicodeDecodeError:
        raise FileError(path, "not valid TOML: it is not text in UTF-8", "save it as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise FileError(path, f"not valid TOML ({error})", "correct that line") from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({os_reason(error)})") from None


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
