"""Evaluate conditions such as ``--fail-if "valid_failure_rate > 0"``: comparisons of figures, and nothing else.

A condition, names included, is checked before the first episode. At the end, a figure without a sample is reported
separately. Evaluators such as simpleeval check names only at the end, after hours of running, and allow far more
than comparisons.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

from advdiff_sumo.core.errors import ConfigError, did_you_mean

_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_ARITHMETIC: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_MAX_LENGTH = 500
_EXAMPLE = "valid_failure_rate > 0 and episodes >= 100"
_EXAMPLE_OF_PAIRS = "valid_failure_rate_only_b > 0 or unpaired > 0"


class Undefined(Exception):  # noqa: N818 - a figure without a sample, not a fault
    """A figure that the result depends on, or a quotient, is undefined; the message says which."""


class Condition:
    """A condition over named figures: comparisons, ``and``, ``or``, ``not``, + − × / and numbers.

    Attributes:
        text: the text as given.
        names: figures that it uses.
    """

    def __init__(self, text: str, names: frozenset[str]) -> None:
        """Check *text*; *names* are the available figures.

        Raises:
            ConfigError: it is no condition, uses an unknown figure, or always divides by zero.
        """
        self.text = text
        if len(text) > _MAX_LENGTH:
            raise ConfigError(f"--fail-if: longer than {_MAX_LENGTH} characters; split it")
        try:
            self._tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise _refused(text, names, "is no condition") from None
        _must_be_condition(self._tree, text, names)
        self.names = _names(self._tree)

    def holds(self, figures: Mapping[str, float | None]) -> bool:
        """Return whether the condition is true for *figures*.

        Raises:
            Undefined: a figure that the result depends on has no value, or is a divisor of zero.
        """
        try:
            return bool(_value(self._tree, figures))
        except ZeroDivisionError:
            raise Undefined(f"divides by zero, with {self.values_text(figures)}") from None

    def values_text(self, figures: Mapping[str, float | None]) -> str:
        """Return the values of its figures as text; "" if it uses none."""
        values = ((name, figures[name]) for name in sorted(self.names))
        return ", ".join(
            f"{name} is undefined" if value is None else f"{name} = {value:.4g}" for name, value in values
        )


def _names(tree: ast.AST) -> frozenset[str]:
    """Return the names in *tree*."""
    return frozenset(node.id for node in ast.walk(tree) if isinstance(node, ast.Name))


def _must_be_condition(node: ast.AST, text: str, names: frozenset[str]) -> None:
    """Check that *node* is a comparison, or a logical combination of comparisons."""
    if isinstance(node, ast.BoolOp):
        for part in node.values:
            _must_be_condition(part, text, names)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        _must_be_condition(node.operand, text, names)
    elif isinstance(node, ast.Compare) and all(type(op) in _COMPARE for op in node.ops):
        for part in (node.left, *node.comparators):
            _must_be_number(part, text, names)
    else:
        raise _refused(text, names, "compares nothing")


def _must_be_number(node: ast.AST, text: str, names: frozenset[str]) -> None:
    """Check that *node* is a number, a known figure, or arithmetic of these."""
    if isinstance(node, ast.Name):
        if node.id not in names:
            raise ConfigError(f"--fail-if {text}: no figure '{node.id}'; {did_you_mean(node.id, names)}")
    elif isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
        _must_be_number(node.left, text, names)
        _must_be_number(node.right, text, names)
        if isinstance(node.op, ast.Div) and not _names(node.right) and _value(node.right, {}) == 0:
            raise _refused(text, names, "divides by zero")
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        _must_be_number(node.operand, text, names)
    elif not (isinstance(node, ast.Constant) and type(node.value) in (int, float)):
        raise _refused(text, names, "holds something that is neither a figure nor a number")


def _value(node: Any, figures: Mapping[str, float | None]) -> Any:
    """Return the value of *node*."""
    if isinstance(node, ast.BoolOp):
        parts = (_value(part, figures) for part in node.values)
        return all(parts) if isinstance(node.op, ast.And) else any(parts)
    if isinstance(node, ast.UnaryOp):
        inner = _value(node.operand, figures)
        return not inner if isinstance(node.op, ast.Not) else -inner
    if isinstance(node, ast.Compare):
        values = [_value(part, figures) for part in (node.left, *node.comparators)]
        pairs = zip(node.ops, values, values[1:], strict=False)
        return all(_COMPARE[type(op)](a, b) for op, a, b in pairs)
    if isinstance(node, ast.BinOp):
        return _ARITHMETIC[type(node.op)](_value(node.left, figures), _value(node.right, figures))
    if isinstance(node, ast.Constant):
        return node.value
    figure = figures[node.id]
    if figure is None:
        raise Undefined(f"{node.id} is undefined, no episode has it")
    return figure


def _refused(text: str, names: frozenset[str], problem: str) -> ConfigError:
    """Return the error for a text that is no valid condition, with an example that uses figures among *names*."""
    example = _EXAMPLE_OF_PAIRS if "pairs" in names else _EXAMPLE
    return ConfigError(f"--fail-if {text}: {problem}; write it like {example}")
