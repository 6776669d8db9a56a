"""Commands on README and site: the parser takes each as it stands, those on filters run, scripts have their options."""

import argparse
import re
import shlex
from pathlib import Path

import pytest

from phyfilter_ctl.cli import _parser, _with_signed_values, main

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted(ROOT.glob("models/*/README.md")),
    ROOT / "fmus/README.md",
]
# What stands for something else, or goes on in words: `export FILE --c DIR | --fmu FILE`, `run ...`.
SCHEMATIC = re.compile(r"\.\.\.|[|<>\[{…]")
JOBS = ("log resample", "log label")  # two words that the command line joins to one


def written(text):
    """Commands in blocks, as lines, and in running text, where they begin with the program's name."""
    blocks = re.findall(r"```(?:bash|sh|console)\n(.*?)```", text, re.S)
    lines = [line for block in blocks for line in block.splitlines()]
    running = re.sub(r"```.*?```", "", text, flags=re.S)
    lines += [line for line in running.splitlines() if re.match(r"    \S*(phyfilter-ctl|python) ", line)]
    lines += [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", running)]
    for line in lines:
        for part in line.split("&&"):
            found = re.search(r"(?:^|\s)(?:\.venv/bin/)?(phyfilter-ctl|python) (.+)", part)
            if found and not SCHEMATIC.search(command := re.split(r"\s{2,}|\s+[>#] ?", found[2])[0]):
                yield found[1], command.strip()


def commands(program):
    return sorted(
        {
            (command, str(page.relative_to(ROOT)))
            for page in PAGES
            for said, command in written(page.read_text())
            if said == program
        }
    )


def words(command):
    arguments = _with_signed_values(shlex.split(command))
    return [" ".join(arguments[:2]), *arguments[2:]] if " ".join(arguments[:2]) in JOBS else arguments


def said_in(path):
    """Of a script, or of all modules of a package."""
    files = path.parent.glob("*.py") if path.name == "__main__.py" else [path]
    return "".join(file.read_text() for file in files)


def refuse(self, message):
    raise ValueError(message)


@pytest.mark.slow
def test_the_parser_takes_every_command(monkeypatch):
    monkeypatch.setattr(argparse.ArgumentParser, "error", refuse)
    monkeypatch.setattr(type(_parser([])), "error", refuse)
    wrong, taken = [], 0
    for command, page in commands("phyfilter-ctl"):
        arguments = words(command)
        if arguments[0] in ("--help", "--version", "COMMAND"):
            continue
        try:
            _parser(arguments).parse_args([word for word in arguments if word != "--help"])
            taken += 1
        except ValueError as error:
            # A command may be named by its first words alone; what else is wrong is.
            if (len(arguments) > 2 and "--help" not in arguments) or "required" not in str(error):
                wrong.append(f"{page}: phyfilter-ctl {command}: {error}")
    assert not wrong, "\n".join(wrong)
    assert taken > 40


@pytest.mark.slow
def test_scripts_have_the_options_that_pages_name():
    wrong, seen = [], 0
    for command, page in commands("python"):
        arguments = shlex.split(command)
        module = (
            arguments[1:2] if arguments[0] == "-m" else [arguments[0].removesuffix(".py").replace("/", ".")]
        )
        stem = ROOT / module[0].replace(".", "/")
        path = stem / "__main__.py" if stem.is_dir() else stem.with_suffix(".py")
        if not module[0].startswith(("benchmarks.", "tests.", "docs.")):
            continue
        if not path.is_file():
            wrong.append(f"{page}: python {command}: there is no {path.relative_to(ROOT)}")
            continue
        seen += 1
        options = [word.partition("=")[0] for word in arguments if word.startswith("--")]
        wrong += [
            f"{page}: python {command}: no {name}"
            for name in options
            if name != "--help" and f'"{name}"' not in said_in(path)
        ]
    assert not wrong, "\n".join(wrong)
    assert seen > 30


@pytest.mark.slow
@pytest.mark.parametrize("page", ["install", "targets"])
def test_commands_on_filters_run(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    found = [
        command
        for said, command in written((ROOT / "docs" / f"{page}.md").read_text())
        if said == "phyfilter-ctl" and command.startswith(("design --", "export filter.toml"))
    ]
    assert found
    for command in found:
        assert main(shlex.split(command)) == 0, command
    shown = capsys.readouterr()
    assert "F(s)" in shown.out
    assert page == "install" or "wrote" in shown.err or "phyfilter.c" in shown.out
