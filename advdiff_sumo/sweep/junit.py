"""Write results as JUnit XML, for continuous integration.

The standard library's ElementTree writes it; junitparser would name the same three elements, and be one more
dependency of every installation.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias
from xml.etree.ElementTree import Element, SubElement, indent, tostring

Row: TypeAlias = Mapping[str, Any]

_FORBIDDEN = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_xml(
    episodes: Sequence[Row],
    failures: Sequence[Row],
    timing: Mapping[int, float],
    condition: tuple[str, str | None] | None,
    lacking: str = "",
) -> bytes:
    """Return JUnit XML with one test case an episode.

    A valid failure is a failure of its test case; an episode that could not be finished is an error. An episode that
    failed after a valid failure is both. Other collisions pass, and are described in the case's output.

    Args:
        episodes: rows of ``episodes``.
        failures: rows of ``failures``.
        timing: episode → wall-clock seconds.
        condition: text of ``--fail-if`` and, if it fails, the values behind it; a test case of its own.
        lacking: error text for episodes that have not been run, a test case of its own; "" for none.
    """
    root = Element("testsuites", name="advdiff-sumo")
    failure_of = {int(row["episode"]): row for row in failures}
    suites: dict[str, list[Row]] = {}
    rows = {int(row["episode"]): row for row in (*failures, *episodes)}
    for number in sorted(rows):
        suites.setdefault(_suite(rows[number]), []).append(rows[number])
    for name, members in suites.items():
        suite = SubElement(root, "testsuite", name=_clean(name))
        for row in members:
            _case(suite, row, failure_of.get(int(row["episode"])), timing)
        _count(suite)
    if lacking:
        suite = SubElement(root, "testsuite", name="missing")
        case = SubElement(suite, "testcase", classname="missing", name="episodes that have not been run")
        SubElement(case, "error", message=_clean(lacking), type="missing")
        _count(suite)
    if condition is not None:
        suite = SubElement(root, "testsuite", name="fail-if")
        case = SubElement(suite, "testcase", classname="fail-if", name=_clean(condition[0]))
        if condition[1] is not None:
            SubElement(case, "failure", message=_clean(condition[1]), type="fail-if")
        _count(suite)
    for name in ("tests", "failures", "errors"):
        root.set(name, str(sum(int(suite.get(name, "0")) for suite in root)))
    indent(root)
    return bytes(tostring(root, encoding="utf-8", xml_declaration=True))


def _suite(row: Row) -> str:
    """Return the name of the suite of *row*: net, situation unless it is any, target, background and seed."""
    options = [row[name] if row[name] != "{}" else "" for name in ("target_options", "background_options")]
    situation = row.get("situation") or "any"
    place = row["net"] if situation == "any" else f"{row['net']} · {situation}"
    return (
        f"{place} · {row['target']}{options[0]} · {row['background']}{options[1]} · seed {row['root_seed']}"
    )


def _case(suite: Element, row: Row, failed: Row | None, timing: Mapping[int, float]) -> None:
    """Add the test case of *row* to *suite*."""
    seconds = timing.get(int(row["episode"]), 0.0)
    name = f"scene {row['number']} ({row['key']})"
    case = SubElement(suite, "testcase", classname=suite.get("name", ""), name=name, time=f"{seconds:.3f}")
    has_collision = bool(row.get("target_collision"))
    if has_collision and fails(row):
        SubElement(case, "failure", type=str(row["collision_type"]), message=_clean(_contact(row)))
    if failed is not None:
        error = SubElement(case, "error", type=str(failed["kind"]), message=_clean(str(failed["message"])))
        error.text = _clean(f"{failed['log_tail']}\n{failed['command']}")
    if has_collision and not fails(row):
        SubElement(case, "system-out").text = _clean(_contact(row))


def _contact(row: Row) -> str:
    """Return a description of the collision."""
    text = f"{row['collision_type']} after {row['collision_time_s']:.1f} s, at fault: {row['at_fault']}"
    return f"{text}. {row.get('verdict') or row['fault_reason'] or ''}".strip()


def fails(row: Row) -> bool:
    """Return whether a test fails by this episode: by the verdict, or by fault where it has none yet."""
    valid = row.get("valid_failure")
    return bool(valid) if valid is not None else row["at_fault"] == "target"


def _count(suite: Element) -> None:
    cases = list(suite)
    suite.set("tests", str(len(cases)))
    suite.set("failures", str(sum(case.find("failure") is not None for case in cases)))
    suite.set("errors", str(sum(case.find("error") is not None for case in cases)))


def _clean(text: str) -> str:
    """Return *text* without characters that XML cannot hold."""
    return _FORBIDDEN.sub("?", text)
