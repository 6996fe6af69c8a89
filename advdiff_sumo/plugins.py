"""Resolve the names of planners, policies and other plug-ins.

A name is a built-in ("lane_graph"), an entry point of a group such as ``advdiff_sumo.planners``, or
``package.module:Class``. Case, hyphens and underscores do not matter in the first two.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from advdiff_sumo.core.errors import ConfigError, UnknownNameError, did_you_mean
from advdiff_sumo.core.plug_in_source import raised_at
from advdiff_sumo.core.wording import in_series

_SCRIPT_REMEDY = "; it was defined in a script or a notebook: put it into a module of its own"


def fold(name: str) -> str:
    """Return *name* in the form used for comparison: lower case, underscores in place of hyphens."""
    return name.strip().lower().replace("-", "_")


@dataclass(frozen=True)
class Registry:
    """Built-ins and plug-ins of one kind.

    Attributes:
        kind: word for messages, such as "target".
        group: entry-point group for plug-ins of third parties.
        builtins: name → "package.module:attribute", imported only when needed.
        descriptions: name of a built-in → description in one line.
    """

    kind: str
    group: str
    builtins: Mapping[str, str] = field(default_factory=dict)
    descriptions: Mapping[str, str] = field(default_factory=dict)

    def names(self) -> list[str]:
        """Return all known names, built-ins first."""
        return [*self.builtins, *(e.name for e in self._plugins())]

    def described(self) -> dict[str, str]:
        """Return all known names with their descriptions; for a plug-in, "plug-in package.module:attribute"."""
        builtins = {name: self.descriptions.get(name, source) for name, source in self.builtins.items()}
        plugins = {
            plugin.name: f"plug-in {plugin.value}"
            for plugin in self._plugins()
            if plugin.name not in builtins
        }
        return builtins | plugins

    def builtin_module(self, name: str) -> str | None:
        """Return the module of the built-in that *name* means; None if it is no built-in."""
        known = _matching_name(self.builtins, name)
        return None if known is None else self.builtins[known].partition(":")[0]

    def is_builtin(self, name: str) -> bool:
        """Return whether *name*, which may also be ``package.module:Class``, means a built-in."""
        return name in self.builtins.values() or _matching_name(self.builtins, name) is not None

    def canonical(self, name: str) -> str:
        """Return *name* as the registry spells it, and ``package.module:Class`` unchanged.

        Raises:
            UnknownNameError: there is no such name; the message suggests the nearest one.
            ConfigError: *name* means a file or a module; the message says how to give a class of it.
        """
        if ":" in name:
            return name
        # built-ins first, since the search for plug-ins is slow
        known = _matching_name(self.builtins, name) or _matching_name(self.names(), name)
        if known is not None:
            return known
        if (file_class := _class_in_a_file(name)) is not None:
            file, spelling = file_class
            raise ConfigError(f"unknown {self.kind} '{name}'; a class of {file} is given as {spelling}")
        raise UnknownNameError(self.kind, name, self.names())

    def load(self, name: str) -> Any:
        """Import and return what *name* means.

        Raises:
            UnknownNameError: no such built-in or plug-in.
            ConfigError: the module or attribute does not exist or its import fails.
        """
        canonical = self.canonical(name)
        if canonical in self.builtins:
            return _import(self.kind, self.builtins[canonical])
        for plugin in self._plugins():
            if plugin.name == canonical:
                return _import(self.kind, plugin.value)
        return _import(self.kind, canonical)

    def factory(self, canonical: str) -> Callable[..., Any]:
        """Return the class or function that *canonical* means; errors as in :meth:`load`, also if it is neither."""
        loaded = self.load(canonical)
        if not callable(loaded):
            raise ConfigError(
                f"{self.kind} '{canonical}' is a {type(loaded).__name__}, not a class or function"
            )
        factory: Callable[..., Any] = loaded
        return factory

    def _plugins(self) -> list[EntryPoint]:
        return sorted(entry_points(group=self.group), key=lambda e: e.name)


def must_take(
    factory: Callable[..., Any],
    options: Mapping[str, Any],
    where: str,
    remedy: str = "",
    elsewhere: Mapping[str, str] | None = None,
) -> None:
    """Check that *factory* can be called with *options*; it is not called.

    Args:
        factory: class or function; one written in C without a signature accepts any options.
        options: keyword arguments.
        where: first words of the message.
        remedy: what to do if an option is missing.
        elsewhere: option → note on who has it, for a *factory* without any options.

    Raises:
        ConfigError: an option is unknown, with the nearest name, or missing.
    """
    try:
        signature = inspect.signature(factory)
    except ValueError:
        return
    try:
        signature.bind(**options)
    except TypeError as error:
        known = [p.name for p in signature.parameters.values() if p.kind is not p.VAR_POSITIONAL]
        unknown = next((key for key in options if key not in known), None)
        if unknown is None:
            raise ConfigError(f"{where}: {error}{remedy}") from None
        no_options = f"it has none{(elsewhere or {}).get(unknown, '')}"
        hint = did_you_mean(unknown, known) if known else no_options
        raise ConfigError(f"{where}: no option '{unknown}'; {hint}") from None


def must_have(what: str, made: object, methods: Iterable[str]) -> None:
    """Check that *made* has all *methods*; *what* is the beginning of the message.

    Raises:
        ConfigError: a method is missing.
    """
    missing = [method for method in methods if not callable(getattr(made, method, None))]
    if missing:
        raise ConfigError(f"{what} lacks {in_series(missing)}")


def _matching_name(names: Iterable[str], name: str) -> str | None:
    """Return the first of *names* that is *name* in another spelling."""
    return next((known for known in names if fold(known) == fold(name)), None)


def _import(kind: str, target: str) -> Any:
    """Import and return *target*, given as ``module:attribute``."""
    module_name, _, attribute = target.partition(":")
    if attribute.startswith("//"):
        raise ConfigError(f"{kind} '{target}' cannot be reached: write it as grpc://HOST:PORT")
    if not (module_name and attribute):
        raise ConfigError(f"{kind} '{target}' cannot be imported: give it as module:CLASS")
    if "/" in module_name or module_name.startswith("."):
        file = Path(f"{module_name.removesuffix('.py')}.py")
        spelling = _importable(file, attribute) if file.is_file() else f"package.module:{attribute}"
        raise ConfigError(
            f"{kind} '{target}' cannot be imported: a module is named, not its path: {spelling}"
        )
    try:
        value: Any = importlib.import_module(module_name)
    except (ImportError, AttributeError, ValueError) as error:
        problem = f"{kind} '{target}' cannot be imported: {error}{_remedy(target, error)}"
        raise ConfigError(problem) from error
    for part in attribute.split("."):
        if not hasattr(value, part):
            raise ConfigError(f"{kind} '{target}' cannot be imported: {_missing_attribute(value, part)}")
        value = getattr(value, part)
    return value


def _class_in_a_file(name: str) -> tuple[Path, str] | None:
    """Return the file that *name*, a path, module or module.Class, means, and how a class of it is given."""
    module, _, attribute = name.rpartition(".")
    candidates = (
        (name.removesuffix(".py"), "CLASS"),
        (name.replace(".", "/"), "CLASS"),
        (module.replace(".", "/"), attribute),
    )
    for path, class_name in candidates:
        if path and (file := Path(f"{path}.py")).is_file():
            return file, _importable(file, class_name)
    return None


def _importable(file: Path, attribute: str) -> str:
    """Return ``module:attribute`` for *attribute* in *file*, and, if necessary, what to put on PYTHONPATH."""
    if file.is_absolute() or ".." in file.parts:
        return f"{file.stem}:{attribute}, with {file.parent} on PYTHONPATH"
    return f"{'.'.join(file.with_suffix('').parts)}:{attribute}"


def _missing_attribute(owner: Any, part: str) -> str:
    """Return that module or class *owner* has no attribute *part*, and suggest one of its own classes."""
    public_names = ((name, value) for name, value in vars(owner).items() if not name.startswith("_"))
    class_names = [name for name, value in public_names if getattr(value, "__module__", "") == owner.__name__]
    hint = f"; {did_you_mean(part, class_names)}" if class_names else ""
    if owner.__name__ == "__main__":
        hint = _SCRIPT_REMEDY
    elif (hidden := _hidden_file(owner)) is not None:
        hint = f"; this module hides {hidden}: give that file another name"
    return f"'{owner.__name__}' has no attribute '{part}'{hint}"


def _hidden_file(owner: Any) -> Path | None:
    """Return the file in the current folder that *owner*, a module from elsewhere, hides; None if there is none."""
    if not isinstance(owner, ModuleType):
        return None
    file = Path.cwd() / f"{owner.__name__.replace('.', '/')}.py"
    is_owner = Path(owner.__file__ or "").resolve() == file.resolve()
    return None if is_owner or not file.is_file() else file


def _remedy(target: str, error: Exception) -> str:
    """Return what to do about an import that failed; by default, the place of the error."""
    module, _, attribute = target.partition(":")
    if module == "__main__":
        return _SCRIPT_REMEDY
    if module.endswith(".py") and Path(module).is_file():
        return f"; leave .py out: {_importable(Path(module), attribute)}"
    if isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]:
        here = Path.cwd()
        return f"; start in the folder of {error.name}.py or put that on PYTHONPATH ({here} was searched)"
    return f"{raised_at(error, None)}; correct it"
