"""Files that cannot be used get one sentence with the file and the remedy."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.export import ExportScene, import_scene, make_exporter

ENDINGS = {
    "openscenario": ".xosc",
    "commonroad": ".cr.xml",
    "scenarionet": ".pkl",
    "fcd": ".fcd.xml",
    "csv": ".csv",
}


@pytest.mark.parametrize("name", ENDINGS)
def test_missing_and_cut_off(name: str, plain: ExportScene, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="nobody"):
        import_scene(tmp_path / f"nobody{ENDINGS[name]}")
    path = make_exporter(name).write(plain, tmp_path)[0]
    whole = path.read_bytes()
    for share in (0.0, 0.3, 0.9):
        path.write_bytes(whole[: int(share * len(whole))])
        if name == "csv" and share > 0.0:
            continue  # a table that ends early is a shorter one; see the cells below
        with pytest.raises(FileError) as refused:
            import_scene(path)
        assert str(path) in str(refused.value)
        assert "\n" not in str(refused.value)


Change = Callable[[str], str]


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("csv", lambda s: s.replace("x_m", "x"), "x_m"),
        ("csv", lambda s: s.replace('"car"', '"boat"'), "BOAT"),
        ("csv", lambda s: s.replace("true", "false"), "has 0 targets"),
        ("csv", lambda s: s.replace("\n0.3,", "\n0.317,"), "not evenly spaced"),
        ("csv", lambda s: s + s.splitlines()[-1] + "\n", "is there twice"),
        ("fcd", lambda s: s.replace('x="', 'u="', 1), "has no x"),
        ("fcd", lambda s: s.replace("type_ego", "type_nobody"), "type_nobody"),
        ("fcd", lambda s: s.replace("fcd-export", "routes"), "begins with <routes>"),
        ("commonroad", lambda s: s.replace("<!-- target: ", "<!-- "), "no comment with the agent's name"),
        ("commonroad", lambda s: s.replace("timeStepSize", "step"), "has no timeStepSize"),
        ("commonroad", lambda s: s.replace("<length>5.0000", "<length>long", 1), "could not convert"),
        ("openscenario", lambda s: s.replace('vehicleCategory="car"', 'vehicleCategory="boat"'), "boat"),
        ("openscenario", lambda s: s.replace('value="target"', 'value="other"'), "has 0 targets"),
        (
            "openscenario",
            lambda s: s.replace("WorldPosition", "LanePosition"),
            "has no Position/WorldPosition",
        ),
    ],
)
def test_content_that_does_not_fit(
    name: str, change: Change, said: str, plain: ExportScene, tmp_path: Path
) -> None:
    path = make_exporter(name).write(plain, tmp_path)[0]
    before = path.read_text(encoding="utf-8")
    path.write_text(change(before), encoding="utf-8")
    assert path.read_text(encoding="utf-8") != before
    with pytest.raises(FileError) as refused:
        import_scene(path)
    assert said in str(refused.value)
    assert "export the episode again" in str(refused.value) or "begins with" in str(refused.value)


def test_the_types_beside_fcd_are_needed(plain: ExportScene, tmp_path: Path) -> None:
    data, types, *_ = make_exporter("fcd").write(plain, tmp_path)
    types.unlink()
    with pytest.raises(FileError, match=r"plain\.add\.xml"):
        import_scene(data)


def test_entities_of_xml_are_not_expanded(tmp_path: Path) -> None:
    path = tmp_path / "bomb.xosc"
    path.write_text('<!DOCTYPE a [<!ENTITY b "c">]><OpenSCENARIO>&b;</OpenSCENARIO>')
    with pytest.raises(FileError, match="not readable as XML"):
        import_scene(path)


class Harmful:
    """Would make a folder when unpickled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (__import__("os").mkdir, (str(self.folder),))


def test_a_pickle_runs_nothing(tmp_path: Path) -> None:
    path = tmp_path / "sd_x.pkl"
    path.write_bytes(pickle.dumps({"id": Harmful(tmp_path / "made")}))
    with pytest.raises(FileError, match="refused"):
        import_scene(path)
    assert not (tmp_path / "made").exists()
