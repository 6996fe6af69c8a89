"""Reads XML files without external entities, and required elements and attributes of them."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from defusedxml.ElementTree import DefusedXMLParser

from advdiff_sumo.core.errors import FileError, os_reason
from advdiff_sumo.core.xml_errors import UNREADABLE_XML
from advdiff_sumo.export.importers.assemble import AGAIN


def read_xml(path: Path, tag: str, what: str) -> ET.Element:
    """Return the root element of *path*, with comments as elements; *what* names the kind of file for messages.

    Raises:
        FileError: the file is missing or truncated, or its root is not *tag*.
    """
    parser = DefusedXMLParser(target=ET.TreeBuilder(insert_comments=True))
    try:
        root: ET.Element | None = ET.parse(path, parser).getroot()  # noqa: S314 - the parser is the safe one
    except OSError as error:
        raise FileError(path, f"cannot be read ({os_reason(error)})", f"give {what}") from None
    except UNREADABLE_XML as error:
        raise FileError(path, f"is not readable as XML ({error})", AGAIN) from None
    if root is None or root.tag != tag:
        root_name = "nothing" if root is None else f"<{root.tag}>"
        raise FileError(path, f"is not {what}: it begins with {root_name}, not <{tag}>")
    return root


def element_at(parent: ET.Element, where: str) -> ET.Element:
    """Return the first element at *where*.

    Raises:
        ValueError: there is none.
    """
    element = parent.find(where)
    if element is None:
        raise ValueError(f"<{parent.tag}> has no {where}")
    return element


def attribute(element: ET.Element, name: str) -> str:
    """Return an attribute.

    Raises:
        ValueError: there is none.
    """
    value = element.get(name)
    if value is None:
        raise ValueError(f"<{element.tag}> has no {name}")
    return value


def text_at(parent: ET.Element, where: str) -> str:
    """Return the text of the first element at *where*.

    Raises:
        ValueError: there is none.
    """
    text = element_at(parent, where).text
    if not text:
        raise ValueError(f"<{parent.tag}> has nothing at {where}")
    return text
