"""Names of planners, policies and other plug-ins resolve here.

A name is a built-in ("lane_graph"), an entry point of a group such as ``advdiff_sumo.planners``, or
``package.module:Class``. Case, hyphen and underscore do not matter for the first two.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import ConfigError, UnknownNameError, did_you_mean
from advdiff_sumo.core.plug_in_source import raised_at
from advdiff_sumo.core.wording import in_series

_OF_A_SCRIPT = "; it was defined in a script or a notebook: put it into a module of its own"


def fold(name: str) -> str:
    """Return *name* as it is compared: lower case, underscores for hyphens."""
    return name.strip().lower().replace("-", "_")


@dataclass(frozen=True)
class Registry:
    """Built-ins and plug-ins of one kind.

    Attributes:
        kind: word for messages, such as "target".
        group: entry-point group that third parties register under.
        builtins: name → "package.module:attribute", imported only when asked for.
        descriptions: name of a built-in → what it is, in a line.
    """

    kind: str
    group: str
    builtins: Mapping[str, str] = field(default_factory=dict)
    descriptions: Mapping[str, str] = field(default_factory=dict)

    def names(self) -> list[str]:
        """Return every name that resolves, built-ins first."""
        return [*self.builtins, *(e.name for e in self._plugins())]

    def described(self) -> dict[str, str]:
        """Return every name that resolves with what it is; of a plug-in "plug-in package.module:attribute"."""
        own = {name: self.descriptions.get(name, source) for name, source in self.builtins.items()}
        plugins = {one.name: f"plug-in {one.value}" for one in self._plugins() if one.name not in own}
        return own | plugins

    def builtin_module(self, name: str) -> str | None:
        """Return the module of the built-in that *name* stands for; None where it is none."""
        known = _same(self.builtins, name)
        return None if known is None else self.builtins[known].partition(":")[0]

    def canonical(self, name: str) -> str:
        """Return *name* as it is spelt in the registry (or unchanged for ``package.module:Class``).

        Raises:
            UnknownNameError: with the nearest name.
        """
        if ":" in name:
            return name
        known = _same(self.builtins, name) or _same(self.names(), name)  # looking for plug-ins takes a while
        if known is not None:
            return known
        if (class_of := _class_in_a_file(name)) is not None:
            file, way = class_of
            raise ConfigError(f"unknown {self.kind} '{name}'; a class of {file} is given as {way}")
        raise UnknownNameError(self.kind, name, self.names())

    def load(self, name: str) -> Any:
        """Import and return what *name* stands for.

        Raises:
            UnknownNameError: no such built-in or plug-in.
            ConfigError: the module or attribute does not exist or fails to import.
        """
        canonical = self.canonical(name)
        if canonical in self.builtins:
            return _import(self.kind, self.builtins[canonical])
        for plugin in self._plugins():
            if plugin.name == canonical:
                return _import(self.kind, plugin.value)
        return _import(self.kind, canonical)

    def factory(self, canonical: str) -> Callable[..., Any]:
        """Return the class or function that *canonical* stands for; errors as in :meth:`load`, or it is neither."""
        loaded = self.load(canonical)
        if not callable(loaded):
            raise ConfigError(
                f"{self.kind} '{canonical}' is a {type(loaded).__name__}, not a class or function"
            )
        made: Callable[..., Any] = loaded
        return made

    def _plugins(self) -> list[EntryPoint]:
        return sorted(entry_points(group=self.group), key=lambda e: e.name)


def must_take(
    factory: Callable[..., Any],
    options: Mapping[str, Any],
    where: str,
    remedy: str = "",
    elsewhere: Mapping[str, str] | None = None,
) -> None:
    """Refuse *options* that *factory* cannot be called with; TypeErrors raised inside it are another matter.

    Args:
        factory: class or function; one written in C without a signature takes anything.
        options: keyword arguments.
        where: first words of the message.
        remedy: what to do where an option is missing.
        elsewhere: option → who has it, said where *factory* has none at all.

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
        none = f"it has none{(elsewhere or {}).get(unknown, '')}"
        hint = did_you_mean(unknown, known) if known else none
        raise ConfigError(f"{where}: no option '{unknown}'; {hint}") from None


def must_have(what: str, made: object, methods: Iterable[str]) -> None:
    """Refuse what was *made* where it lacks one of *methods*; *what* begins the message.

    Raises:
        ConfigError: it does.
    """
    missing = [method for method in methods if not callable(getattr(made, method, None))]
    if missing:
        raise ConfigError(f"{what} lacks {in_series(missing)}")


def _same(names: Iterable[str], name: str) -> str | None:
    """Return the first of *names* that is *name* in another spelling."""
    return next((known for known in names if fold(known) == fold(name)), None)


def _import(kind: str, target: str) -> Any:
    module_name, _, attribute = target.partition(":")
    if attribute.startswith("//"):
        raise ConfigError(f"{kind} '{target}' cannot be reached: write it as grpc://HOST:PORT")
    if not (module_name and attribute):
        raise ConfigError(f"{kind} '{target}' cannot be imported: give it as module:CLASS")
    if "/" in module_name or module_name.startswith("."):
        file = Path(f"{module_name.removesuffix('.py')}.py")
        way = _importable(file, attribute) if file.is_file() else f"package.module:{attribute}"
        raise ConfigError(f"{kind} '{target}' cannot be imported: a module is named, not its path: {way}")
    try:
        value: Any = importlib.import_module(module_name)
    except (ImportError, AttributeError, ValueError) as error:
        problem = f"{kind} '{target}' cannot be imported: {error}{_remedy(target, error)}"
        raise ConfigError(problem) from error
    for part in attribute.split("."):
        if not hasattr(value, part):
            raise ConfigError(f"{kind} '{target}' cannot be imported: {_lacks(value, part)}")
        value = getattr(value, part)
    return value


def _class_in_a_file(name: str) -> tuple[Path, str] | None:
    """Return the file that *name*, a path, a module or module.Class, means, and how a class of it is given."""
    module, _, attribute = name.rpartition(".")
    meant = (
        (name.removesuffix(".py"), "CLASS"),
        (name.replace(".", "/"), "CLASS"),
        (module.replace(".", "/"), attribute),
    )
    for path, of_it in meant:
        if path and (file := Path(f"{path}.py")).is_file():
            return file, _importable(file, of_it)
    return None


def _importable(file: Path, attribute: str) -> str:
    """Return *attribute* of the module in *file* as ``module:attribute``, and where one has to start."""
    if file.is_absolute() or ".." in file.parts:
        return f"{file.stem}:{attribute}, with {file.parent} on PYTHONPATH"
    return f"{'.'.join(file.with_suffix('').parts)}:{attribute}"


def _lacks(owner: Any, part: str) -> str:
    """Return that *owner*, a module or a class, has no *part*, and which of its own classes may be meant."""
    public = ((name, own) for name, own in vars(owner).items() if not name.startswith("_"))
    kinds = [name for name, own in public if getattr(own, "__module__", "") == owner.__name__]
    near = f"; {did_you_mean(part, kinds)}" if kinds else ""
    if owner.__name__ == "__main__":
        near = _OF_A_SCRIPT
    return f"'{owner.__name__}' has no attribute '{part}'{near}"


def _remedy(target: str, error: Exception) -> str:
    """Return what to do where a module was not found, or could not be by another process; else where it failed."""
    module, _, attribute = target.partition(":")
    if module == "__main__":
        return _OF_A_SCRIPT
    if module.endswith(".py") and Path(module).is_file():
        return f"; leave .py out: {_importable(Path(module), attribute)}"
    if isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]:
        here = Path.cwd()
        return f"; start in the folder of {error.name}.py or put that on PYTHONPATH ({here} was searched)"
    return f"{raised_at(error, None)}; correct it"
