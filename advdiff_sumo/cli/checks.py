"""The checks of ``advdiff-sumo doctor``: each returns findings and, if something is wrong, a remedy."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("numpy", "scipy", "shapely", "pyproj", "pyarrow", "torch", "pydantic", "typer", "matplotlib")
SUMO_PACKAGES = ("eclipse-sumo", "libsumo", "sumolib")
NEEDED_BINARIES, OPTIONAL_BINARIES = ("sumo", "netconvert"), ("sumo-gui",)
EXTRAS = {
    "sql": ("duckdb",),
    "pandas": ("pandas",),
    "osi": ("osi-python",),
    "train": ("tensorboard",),
    "openscenario": ("scenariogeneration",),
    "video": ("imageio", "imageio-ffmpeg"),
    "ray": ("ray",),
    "rl": ("gymnasium", "stable-baselines3"),
}
SELF_TEST_S = 5
_SELF_TEST_LIMIT_S = 300
_INSTALL_AGAIN = "install the package again: pip install -c constraints.txt -e ."


class CheckState(StrEnum):
    """Result of a check."""

    OK = "ok"
    NOTE = "note"
    PROBLEM = "problem"


@dataclass(frozen=True)
class CheckFinding:
    """One line of the doctor's table.

    Attributes:
        topic: what was checked.
        state: ok, note (something optional is missing) or problem.
        text: what was found.
        hint: remedy; "" if none is needed.
    """

    topic: str
    state: CheckState
    text: str
    hint: str = ""


def python() -> Iterator[CheckFinding]:
    """Check Python, the machine and the required libraries."""
    from advdiff_sumo import __version__  # late: the commands start faster

    yield CheckFinding("advdiff-sumo", CheckState.OK, f"{__version__}, Python {platform.python_version()}")
    yield CheckFinding("machine", CheckState.OK, f"{platform.platform()}, {os.cpu_count()} cores")
    versions = {name: _version(name) for name in PACKAGES}
    missing = [name for name, number in versions.items() if number is None]
    if missing:
        yield CheckFinding(
            "libraries", CheckState.PROBLEM, f"{', '.join(missing)} not installed", _INSTALL_AGAIN
        )
    else:
        yield CheckFinding(
            "libraries", CheckState.OK, ", ".join(f"{name} {number}" for name, number in versions.items())
        )


def sumo() -> Iterator[CheckFinding]:
    """Check SUMO's packages, which must have the same version, and its programs."""
    versions = {name: _version(name) for name in SUMO_PACKAGES}
    text = ", ".join(f"{name} {number or 'not installed'}" for name, number in versions.items())
    if None in versions.values():
        yield CheckFinding("SUMO", CheckState.PROBLEM, text, _INSTALL_AGAIN)
        return
    if len(set(versions.values())) > 1:
        yield CheckFinding("SUMO", CheckState.PROBLEM, text, "install all three in one version")
    else:
        yield CheckFinding("SUMO", CheckState.OK, text)
    for name in (*NEEDED_BINARIES, *OPTIONAL_BINARIES):
        yield _binary(name)
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        yield CheckFinding(
            "display", CheckState.NOTE, "none", "--gui and sumo-gui need one; set DISPLAY to use them"
        )


def _binary(name: str) -> CheckFinding:
    """Run SUMO's program *name* to get its version, and return the finding."""
    import sumolib  # late, as above

    needed = name in NEEDED_BINARIES
    try:
        path = sumolib.checkBinary(name)
        result = subprocess.run([path, "--version"], capture_output=True, text=True, check=False, timeout=60)
    except (OSError, SystemExit, subprocess.TimeoutExpired) as error:
        return CheckFinding(
            name,
            CheckState.PROBLEM if needed else CheckState.NOTE,
            f"does not start ({error})",
            _INSTALL_AGAIN,
        )
    if result.returncode != 0:
        reason = (result.stderr.strip().splitlines() or [f"exit code {result.returncode}"])[-1]
        remedy = "install the system libraries that it names" if not needed else _INSTALL_AGAIN
        return CheckFinding(
            name, CheckState.PROBLEM if needed else CheckState.NOTE, f"does not start: {reason}", remedy
        )
    return CheckFinding(name, CheckState.OK, f"{result.stdout.splitlines()[0]}, {path}")


def gpu() -> Iterator[CheckFinding]:
    """Check for a GPU. It is optional, but training is slow without one."""
    try:
        import torch  # late, as above
    except (ImportError, OSError) as error:
        yield CheckFinding("GPU", CheckState.PROBLEM, f"torch cannot be imported ({error})", _INSTALL_AGAIN)
        return
    if torch.cuda.is_available():
        names = [torch.cuda.get_device_name(number) for number in range(torch.cuda.device_count())]
        yield CheckFinding("GPU", CheckState.OK, ", ".join(names))
    else:
        hint = "none is needed to run; for training, install the torch build of your GPU first"
        yield CheckFinding("GPU", CheckState.NOTE, f"torch {torch.__version__} sees none", hint)


def nets() -> Iterator[CheckFinding]:
    """Check that the shipped nets are present."""
    from advdiff_sumo.core.errors import FileError  # late, as above
    from advdiff_sumo.maps.shipped_nets import NETS_BY_NAME, shipped_networks

    try:
        folder = shipped_networks()
    except FileError as error:
        yield CheckFinding("nets", CheckState.PROBLEM, str(error), _INSTALL_AGAIN)
        return
    missing = [name for name in NETS_BY_NAME if not (folder / f"{name}.net.xml").is_file()]
    if missing:
        yield CheckFinding("nets", CheckState.PROBLEM, f"{folder} lacks {', '.join(missing)}", _INSTALL_AGAIN)
    else:
        yield CheckFinding("nets", CheckState.OK, f"{', '.join(NETS_BY_NAME)} in {folder}")


def weights() -> Iterator[CheckFinding]:
    """Check for the trained weights that are part of the package."""
    import advdiff_sumo  # late, as above

    folder = Path(advdiff_sumo.__file__).resolve().parent / "weights"
    names = sorted(path.name for path in folder.glob("*.safetensors"))
    if names:
        yield CheckFinding("weights", CheckState.OK, f"{', '.join(names)} in {folder}")
    else:
        hint = "learned backgrounds need them: advdiff-sumo train makes your own"
        yield CheckFinding("weights", CheckState.NOTE, "none came with this package", hint)


def loops() -> Iterator[CheckFinding]:
    """Check whether the machine code of the networks in the package runs on this machine."""
    from advdiff_sumo.diffusion.attack import costs_package  # late, as above
    from advdiff_sumo.diffusion.machine_code import runs_here

    package = costs_package()
    if runs_here(package):
        yield CheckFinding(
            "machine code", CheckState.OK, f"for this PyTorch and processor, such as {package.name}"
        )
    else:
        hint = "plans take two to three times as long; constraints.txt has the PyTorch that it is for"
        yield CheckFinding("machine code", CheckState.NOTE, "none for this PyTorch and processor", hint)


def data() -> Iterator[CheckFinding]:
    """Check for driving logs in the folder that the variable ADVDIFF_DATA names."""
    setting = os.environ.get("ADVDIFF_DATA")
    if not setting:
        hint = "logs are optional; the tests find theirs through ADVDIFF_DATA=FOLDER, runs through --scenes"
        yield CheckFinding("data", CheckState.NOTE, "ADVDIFF_DATA is not set", hint)
        return
    root = Path(setting)
    if not root.is_dir():
        yield CheckFinding(
            "data", CheckState.PROBLEM, f"ADVDIFF_DATA={setting} is no folder", "correct it or unset it"
        )
        return
    patterns = ("v1.0-*", "*/v1.0-*")
    tables = sorted({path.parent for glob in patterns for path in root.glob(glob) if path.is_dir()})
    maps = sorted({path.parent for top in ("", "*/") for path in root.glob(f"{top}maps/expansion/*.json")})
    records = sum(1 for top in ("", "*/") for _ in root.glob(f"{top}sd_*.pkl"))
    kinds = [f"nuScenes tables in {path}" for path in tables] + [f"HD maps in {path}" for path in maps]
    if records:
        kinds.append(f"{records} ScenarioNet records")
    if kinds:
        yield CheckFinding("data", CheckState.OK, ", ".join(kinds))
    else:
        hint = "put a nuScenes dataset root or ScenarioNet records (sd_*.pkl) there"
        yield CheckFinding("data", CheckState.NOTE, f"{root} holds no log that is known", hint)


def extras() -> Iterator[CheckFinding]:
    """Check for the optional packages."""
    for extra, names in EXTRAS.items():
        missing = [name for name in names if _version(name) is None]
        if missing:
            hint = f"pip install 'advdiff-sumo[{extra}]'"
            yield CheckFinding(f"extra {extra}", CheckState.NOTE, f"{', '.join(missing)} not installed", hint)
        else:
            numbers = ", ".join(f"{name} {_version(name)}" for name in names)
            yield CheckFinding(f"extra {extra}", CheckState.OK, numbers)


def self_test() -> Iterator[CheckFinding]:
    """Run one episode in a separate process, so that even a crash of SUMO results in a finding."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "advdiff_sumo", "run", "--out", str(Path(folder) / "run")]
        command += ["--episodes", "1", "--horizon", str(SELF_TEST_S), "--set", "scene.warmup_s=10"]
        command += ["--set", "scene.scenes_per_warmup=1", "--set", "scene.min_neighbours=1"]
        try:
            result = subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=_SELF_TEST_LIMIT_S
            )
        except subprocess.TimeoutExpired:
            hint = "the machine is too busy or too slow; try again when it is idle"
            text = f"not done after {_SELF_TEST_LIMIT_S} s"
            yield CheckFinding("self-test", CheckState.PROBLEM, text, hint)
            return
        yield _self_test_finding(Path(folder) / "run", result)


def _self_test_finding(folder: Path, result: subprocess.CompletedProcess[str]) -> CheckFinding:
    """Return the finding of the self-test, whose run is in *folder* and whose process ended with *result*."""
    code = result.returncode
    if code != 0:
        reason = (result.stderr.strip().splitlines() or ["nothing was said"])[-1]
        end = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
        return CheckFinding("self-test", CheckState.PROBLEM, f"{end}: {reason}", _INSTALL_AGAIN)
    import pyarrow.parquet as pq  # late, as above

    row = pq.read_table(folder / "episodes.parquet").to_pylist()[0]
    timing = pq.read_table(folder / "timing.parquet").to_pylist()[0]
    if row["end"] == "failed":
        return CheckFinding(
            "self-test", CheckState.PROBLEM, f"the episode failed: {row['failure_message']}", _INSTALL_AGAIN
        )
    text = f"{row['duration_s']:.1f} s driven among {row['agents']} road users, "
    return CheckFinding("self-test", CheckState.OK, f"{text}{timing['real_time_factor']:.1f} × real time")


#: All checks in the order of the table; the self-test takes several seconds.
CHECKS: tuple[Callable[[], Iterator[CheckFinding]], ...] = (
    *(python, sumo, gpu, nets, weights, loops, data, extras, self_test),
)


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
