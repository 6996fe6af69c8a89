"""Every OSError has a reason in words, also if a library raised it without a number."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

import advdiff_sumo
from advdiff_sumo.config import read_toml
from advdiff_sumo.core.errors import FileError, os_reason
from advdiff_sumo.core.whole_file import make_folder

PACKAGE = Path(advdiff_sumo.__file__).parent
WITHOUT_PACKAGE = PACKAGE / "planners" / "remote" / "keeper.py"  # runs in an interpreter that has none


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "out"), "No space left on device"),
        (OSError("the share is gone"), "the share is gone"),
        (OSError(), "OSError"),
        (TimeoutError(), "TimeoutError"),
    ],
)
def test_a_reason_is_never_empty(error: OSError, reason: str) -> None:
    assert os_reason(error) == reason


def test_a_file_that_a_library_cannot_read_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> str:
        raise OSError("the share is gone")

    monkeypatch.setattr(Path, "read_text", refuse)
    with pytest.raises(FileError, match=r"cannot be read \(the share is gone\)"):
        read_toml(tmp_path / "run.toml")
    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(FileError, match=r"cannot be made \(the share is gone\)"):
        make_folder(tmp_path / "out")


def test_all_modules_use_os_reason() -> None:
    asking = {path for path in PACKAGE.rglob("*.py") if ".strerror" in path.read_text(encoding="utf-8")}
    assert asking == {PACKAGE / "core" / "errors.py", WITHOUT_PACKAGE}
