"""Fenced blocks of the pages, what a comment before one says about testing it, and the commands inside.

A comment on the line before a block says how it is tested::

    <!-- test: skip, REASON -->      its options are checked, it is not run
    <!-- test: slow, REASON -->      the same, but run where ADVDIFF_DOCS=all
    <!-- test: data -->              run where ADVDIFF_DATA names the real data
    <!-- test: weights -->           run where trained weights ship with the package
    <!-- test: file my_planner.py --> not a command: the block is written to that file for the commands after it
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHELL = ("sh", "console")
_BLOCK = re.compile(
    r"^(?:<!-- test: (?P<mark>\w+),? ?(?P<rest>[^\n]*?) ?-->\n+)?```(?P<language>[^\n]*)\n(?P<code>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
_INLINE = re.compile(r"`(advdiff-sumo [^`\n]+)`")
_PROMPT = re.compile(r"^[\w-]*\$ ")
_HEREDOC = re.compile(r"<<'(\w+)'([^\n]*)\n.*?^\1$", re.MULTILINE | re.DOTALL)
_SEPARATORS = {"&&", "||", ";", "|", "&"}
_ASSIGNMENT = re.compile(r"^[A-Z][A-Z0-9_]*=")


@dataclass(frozen=True)
class Block:
    """One fenced block.

    Attributes:
        page: file, relative to the repository.
        line: where its fence opens.
        language: as written behind the fence.
        code: what stands inside.
        mark: how it is tested; empty: run.
        rest: the reason, or the name of the file.
    """

    page: str
    line: int
    language: str
    code: str
    mark: str
    rest: str

    @property
    def script(self) -> str:
        """The commands, without prompts and, in ``console``, without what they print."""
        if self.language != "console":
            return self.code
        lines = self.code.splitlines()
        return "\n".join(_PROMPT.sub("", line) for line in lines if _PROMPT.match(line)) + "\n"


def pages() -> list[str]:
    """Return all pages that hold commands, those that others build on first."""
    named = ["README.md", "CONTRIBUTING.md", "docs/tour.md"]
    return [*named, *sorted({f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")} - {*named})]


def blocks(page: str) -> list[Block]:
    """Return the fenced blocks of *page* in order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found = []
    for match in _BLOCK.finditer(text):
        line = text.count("\n", 0, match.start("language")) + 1
        mark, rest = match["mark"] or "", match["rest"] or ""
        found.append(Block(page, line, match["language"].strip(), match["code"], mark, rest))
    return found


def shell_blocks() -> list[Block]:
    """Return every block of commands of every page."""
    return [block for page in pages() for block in blocks(page) if block.language in SHELL]


def inline_commands(page: str) -> list[list[str]]:
    """Return the commands that stand in the running text of *page*."""
    prose = _BLOCK.sub("", (ROOT / page).read_text(encoding="utf-8"))
    return [shlex.split(command) for command in _INLINE.findall(prose)]


def commands(script: str) -> list[list[str]]:
    """Return the words of each simple command of *script*: no comments, redirections or settings before it."""
    found: list[list[str]] = []
    for line in _logical_lines(_HEREDOC.sub(r"\2", script)):
        words: list[str] = []
        for token in [*_tokens(line), ";"]:
            if token in _SEPARATORS:
                found.append(words)
                words = []
            else:
                words.append(token)
    return [bare for words in found if (bare := _bare(words))]


def _logical_lines(script: str) -> list[str]:
    """Join lines that a backslash or an open quote holds together."""
    lines, held = [], ""
    for line in script.replace("\\\n", " ").splitlines():
        held = f"{held}\n{line}" if held else line
        try:
            shlex.split(held, comments=True)
        except ValueError:
            continue
        lines.append(held)
        held = ""
    if held:
        raise ValueError(f"a quote stays open: {held}")
    return lines


def _tokens(line: str) -> list[str]:
    lexer = shlex.shlex(line, posix=True, punctuation_chars="<>|&;")
    lexer.whitespace_split = True
    return list(lexer)


def _bare(words: list[str]) -> list[str]:
    """Return *words* up to the first redirection, without assignments in front."""
    kept = words[: next((i for i, word in enumerate(words) if word in {"<", ">", ">>"}), len(words))]
    while kept and _ASSIGNMENT.match(kept[0]):
        kept = kept[1:]
    return kept
