"""Base class of all options: strict and frozen, with suggestions for misspelt names."""

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
"""Root of random numbers; tables store it in 64 bits."""


def _finite(options: _Own) -> _Own:
    """Refuse NaN and infinity, which result files cannot contain, also in lists and tables."""
    for name, value in options.items():
        if not _is_finite(value):
            raise ValueError(f"{name} = {_short(value)}: give finite numbers")
    return options


def _is_finite(value: Any) -> bool:
    """Return whether *value*, or all values in it, are finite; what is not a number counts as finite."""
    if isinstance(value, Mapping):
        return all(map(_is_finite, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


OwnOptions: TypeAlias = Annotated[dict[str, Any], AfterValidator(_finite)]
"""A planner's or policy's own options, by name."""
Variants: TypeAlias = Annotated[dict[str, tuple[Any, ...]], AfterValidator(_finite)]
"""Values to try of each such option."""

#: A name this similar to one of its own group, such as "backgrounds" to "background", counts as a misspelling of it;
#: other groups are then not searched.
_MISSPELT = 0.85


class Options(BaseModel):
    """Immutable options; unknown names are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def parse(cls, values: Mapping[str, Any], where: str = "options") -> Self:
        """Validate *values*.

        Args:
            values: nested dictionary of plain values.
            where: source of the values, for the message.

        Raises:
            ConfigError: one sentence that names the option, the value and the remedy.
        """
        try:
            return cls.model_validate(dict(values))
        except ValidationError as error:
            raise ConfigError(f"{where}: {_sentence(cls, error)}") from None


def _sentence(model: type[BaseModel], error: ValidationError) -> str:
    """Return the first problem in *error* as a sentence."""
    first = error.errors(include_url=False)[0]
    path, value = first["loc"], first["input"]
    key = _dotted(path)
    if first["type"] == "extra_forbidden":
        return f"no option '{key}'; {_remedy(model, path)}"
    if first["type"] == "missing":
        return f"option '{key}' is missing"
    if first["type"] == "model_type":
        example = _dotted((*path, next(iter(_group(model, path).model_fields))))
        if isinstance(value, list):
            return f"{key} = {_short(value)}: that is a list; a group of options belongs there, such as {example}"
        return f"{key} = {_short(value)}: that is a group of options; set one of them, such as {example}"
    if first["type"] == "tuple_type":
        return f"{key} = {_short(value)}: give a list, such as [{_short(value)}]"
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "value_error" and isinstance(value, Mapping):
        # a rule about several options names them itself
        return f"{key}: {message}" if key else message
    return f"{key or 'value'} = {_short(value)}: {message[0].lower()}{message[1:]}"


def _remedy(model: type[BaseModel], path: tuple[int | str, ...]) -> str:
    """Return a suggestion for the unknown option at *path*.

    It is the nearest name in the same group if that is similar enough, else the same name in another group, else the
    nearest name in the same group.
    """
    same_name = [
        name for name in _leaves(model) if name.rpartition(".")[2] == str(path[-1]).rpartition(".")[2]
    ]
    if _dotted(path) in same_name:
        return "write it without quotation marks: a name with a dot in quotation marks is another one"
    siblings = list(_group(model, path[:-1]).model_fields)
    if same_name and nearest(str(path[-1]), siblings, _MISSPELT) is None:
        if same_name == [path[-1]] and any(isinstance(part, int) for part in path):
            return f"'{path[-1]}' holds for the whole file: write it above its first [table]"
        return did_you_mean(_dotted(path), same_name)
    return did_you_mean(str(path[-1]), siblings)


def _dotted(path: tuple[int | str, ...]) -> str:
    """Return *path* as a dotted name."""
    return ".".join(str(part) for part in path)


def _short(value: Any) -> str:
    """Return *value* as Python writes it, with long ones shortened and groups of options as "{...}"."""
    short_repr = reprlib.Repr()
    short_repr.maxdict, short_repr.maxlist, short_repr.maxstring, short_repr.maxother = 0, 4, 40, 40
    return short_repr.repr(value)


def _group(model: type[BaseModel], path: tuple[int | str, ...]) -> type[BaseModel]:
    """Return the model of the group of options at *path*; if there is none, that of the last group on the way."""
    for part in path:
        if isinstance(part, int):
            continue  # a position in a list of groups
        group = _groups(model).get(part)
        if group is None:
            break
        model = group
    return model


def _groups(model: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """Return the fields of *model* that contain a group of options, or several of one kind."""
    groups = {}
    for name, info in model.model_fields.items():
        for candidate in (info.annotation, *get_args(info.annotation)):
            if isinstance(candidate, type) and issubclass(candidate, BaseModel):
                groups[name] = candidate
    return groups


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
        raise FileError(
            path, "no such file", "check the path; a sweep or run is described in a TOML file"
        ) from None
    except UnicodeDecodeError:
        raise FileError(path, "not valid TOML: it is not text in UTF-8", "save it as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise FileError(path, f"not valid TOML ({error})", "correct that line") from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({os_reason(error)})") from None


def set_dotted(values: dict[str, Any], assignment: str) -> None:
    """Set one ``a.b=c`` of ``--set`` in nested *values*, in place; c is read as a TOML value, or else as text.

    Raises:
        ConfigError: there is no "=" in it, or a part of the path is not a group of options.
    """
    path, equals, text = assignment.partition("=")
    if not equals or not path.strip():
        raise ConfigError(f"--set {assignment}: expected NAME=VALUE, for example --set sim.step_s=0.1")
    *parents, leaf = path.strip().split(".")
    group = values
    for parent in parents:
        group = group.setdefault(parent, {})
        if not isinstance(group, dict):
            raise ConfigError(f"--set {assignment}: '{parent}' is not a group of options")
    group[leaf] = _toml_value(text.strip())


def _toml_value(text: str) -> Any:
    """Return *text* as a TOML value, or as it is if it is none."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
