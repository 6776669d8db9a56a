"""Options and files of a job, and the numbers that it reads."""

from __future__ import annotations

import json
from argparse import ArgumentParser
from dataclasses import dataclass
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from phyfilter_ctl.study import Outputs, add_output_options, parameter_file, read_parameters


@dataclass(frozen=True)
class Body:
    mass: float
    inertia: tuple[float, ...]


@dataclass(frozen=True)
class Cart:
    body: Body


MASS = 'mass = { value = 1.5, unit = "kg", reason = "weighed" }\n'
INERTIA = 'inertia = { value = [1.0, 2.0], unit = "kg m^2", reason = "of a box" }\n'


def test_table_figures_and_picture_go_where_they_are_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def no_picture() -> Figure:
        raise AssertionError("nobody asked for a picture")

    Outputs(str(tmp_path / "a.json")).publish("the table", {"a": 1}, no_picture)
    assert capsys.readouterr().out == "the table\n"
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": 1}
    Outputs("-", str(tmp_path / "a.svg")).publish("the table", {"a": 1}, Figure)
    assert json.loads(capsys.readouterr().out) == {"a": 1}
    assert (tmp_path / "a.svg").is_file()


def test_a_picture_in_a_folder_makes_it_once_there_is_one(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    outputs = Outputs(picture="a.svg", quiet=True, folder=str(folder))
    assert not folder.exists()
    for _ in range(2):
        outputs.publish("the table", {}, Figure)
        assert [path.name for path in folder.iterdir()] == ["a.svg"]
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        Outputs(picture="a.svg", folder=str(tmp_path / "absent" / "run"))
    with pytest.raises(FileExistsError, match="is a file, expected a folder"):
        Outputs(picture="a.svg", folder=str(folder / "a.svg"))


def test_files_that_cannot_be_written_are_refused_first(tmp_path: Path) -> None:
    parser = ArgumentParser()
    add_output_options(parser, "cart", description="", examples="")
    assert Outputs.of(parser.parse_args(["--picture", "none"])) == Outputs()
    for arguments, words in ((["--picture", "a.xyz"], "ends in"), (["--json", str(tmp_path)], "is a folder")):
        with pytest.raises(ValueError, match=words):
            Outputs.of(parser.parse_args(arguments))


def test_numbers_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "cart.toml"
    file.write_text(f"[body]\n{MASS}{INERTIA}")
    numbers = parameter_file(file, Cart)
    assert numbers() == Cart(Body(1.5, (1.0, 2.0)))
    file.unlink()
    assert numbers().body.mass == 1.5  # read once


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"[body]\n{MASS}", r"cart.toml: \[body\]: expected the keys inertia, mass, got mass"),
        (f"[boddy]\n{MASS}{INERTIA}", "expected the tables body, got boddy"),
        (
            f"[body]\n{MASS.replace('weighed', '')}{INERTIA}",
            r"\[body\] mass: expected value, unit and reason",
        ),
        ("[body", "cart.toml: no TOML file"),
    ],
)
def test_wrong_files_are_named(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "cart.toml").write_text(text)
    with pytest.raises(ValueError, match=words):
        read_parameters(tmp_path / "cart.toml", Cart)
