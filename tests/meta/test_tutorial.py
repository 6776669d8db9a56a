"""The tutorial is what it says: its lines run one after the other, and the figures in its text hold."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl.cli import main

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "tutorial.md").read_text()


@pytest.mark.slow
def test_tutorial_runs_as_it_stands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    kinds = []
    for language, body in re.findall(r"```(\w+)\n(.*?)```", TEXT, re.S):
        kinds.append(language)
        if language == "python":
            exec(compile(body, "tutorial.md", "exec"), names)
        elif language == "toml":
            Path("cart.toml").write_text(body)
        else:
            for line in body.strip().splitlines():
                command, *arguments = shlex.split(line)
                assert command == "phyfilter-ctl"
                assert main(arguments) == 0, line
    assert kinds == ["python", "bash", "toml", "bash", "bash", "python", "bash"]
    said = capsys.readouterr().out
    assert "bound" in said
    rms = float(np.sqrt(np.mean(names["error"] ** 2)))
    missed = float(np.sqrt(np.mean(names["missed"] ** 2)))
    assert f"an rms of {rms:.2f} N, of a missing force of {missed:.1f} N" in TEXT
    for path in ("missed.png", "promises.png", "firmware/phyfilter.c", "zephyr_module"):
        assert (tmp_path / path).exists(), path
