"""Read the fenced blocks of the pages: how they are tested, and their commands.

A comment on the line before a block says how it is tested::

    <!-- test: skip, REASON -->      its options are checked, but it is not run
    <!-- test: slow, REASON -->      the same, but it is run if ADVDIFF_DOCS=all
    <!-- test: data -->              run if ADVDIFF_DATA names the real data
    <!-- test: weights -->           run if the package has trained weights
    <!-- test: file my_planner.py --> not a command: the block is written to that file for later commands
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
        line: line of the opening fence.
        language: word after the fence.
        code: contents.
        mark: how it is tested; "": it is run.
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
        """The commands; for ``console``, without prompts and output."""
        if self.language != "console":
            return self.code
        lines = self.code.splitlines()
        return "\n".join(_PROMPT.sub("", line) for line in lines if _PROMPT.match(line)) + "\n"


def pages() -> list[str]:
    """Return all pages with commands; those whose results other pages use come first."""
    first = ["README.md", "CONTRIBUTING.md", "docs/tour.md"]
    return [*first, *sorted({f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")} - {*first})]


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
    """Return all blocks of commands of all pages."""
    return [block for page in pages() for block in blocks(page) if block.language in SHELL]


def inline_commands(page: str) -> list[list[str]]:
    """Return the commands in the running text of *page*."""
    prose = _BLOCK.sub("", (ROOT / page).read_text(encoding="utf-8"))
    return [shlex.split(command) for command in _INLINE.findall(prose)]


def commands(script: str) -> list[list[str]]:
    """Return the words of each simple command of *script*, without comments, redirections and assignments."""
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
    """Return the lines of *script*; those connected by a backslash or an open quote are joined."""
    lines, pending = [], ""
    for line in script.replace("\\\n", " ").splitlines():
        pending = f"{pending}\n{line}" if pending else line
        try:
            shlex.split(pending, comments=True)
        except ValueError:
            continue
        lines.append(pending)
        pending = ""
    if pending:
        raise ValueError(f"a quote stays open: {pending}")
    return lines


def _tokens(line: str) -> list[str]:
    lexer = shlex.shlex(line, posix=True, punctuation_chars="<>|&;")
    lexer.whitespace_split = True
    return list(lexer)


def _bare(words: list[str]) -> list[str]:
    """Return *words* up to the first redirection, without leading assignments."""
    kept = words[: next((i for i, word in enumerate(words) if word in {"<", ">", ">>"}), len(words))]
    while kept and _ASSIGNMENT.match(kept[0]):
        kept = kept[1:]
    return kept
