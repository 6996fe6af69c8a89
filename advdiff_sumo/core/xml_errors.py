"""What a parser raises of XML that it cannot or must not read."""

from __future__ import annotations

from xml.etree.ElementTree import ParseError

from defusedxml import DefusedXmlException

UNREADABLE_XML = (ParseError, DefusedXmlException, ValueError, LookupError)
"""Not well-formed, with entities or references to elsewhere, in an encoding of several bytes, in an unknown one."""
