"""Extension of griffe for the site: replaces roles such as ``:class:`~package.Name``` in docstrings by ``Name``."""

from __future__ import annotations

import re
from typing import Any

import griffe

_ROLE = re.compile(r":(?:class|func|meth|attr|data|mod|exc):`(~?)([\w.]+)`")


def without_roles(text: str) -> str:
    """Return *text* with each role replaced by code; after ``~``, only the last part of the name is used."""
    return _ROLE.sub(lambda match: f"`{match[2].rpartition('.')[2] if match[1] else match[2]}`", text)


class DocstringRoles(griffe.Extension):
    """Replaces the roles in every docstring."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of *obj*."""
        if obj.docstring is not None:
            obj.docstring.value = without_roles(obj.docstring.value)
