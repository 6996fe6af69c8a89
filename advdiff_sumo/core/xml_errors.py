"""Exceptions of a parser for XML that it cannot or must not read."""

from __future__ import annotations

from xml.etree.ElementTree import ParseError

from defusedxml import DefusedXmlException

UNREADABLE_XML = (ParseError, DefusedXmlException, ValueError, LookupError)
"""Not well-formed; with entities or external references; in a multi-byte encoding; in an unknown encoding."""
