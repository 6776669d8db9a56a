"""The README is what it says: short, and its lines run as they stand."""

import re
from pathlib import Path

import numpy as np

TEXT = (Path(__file__).resolve().parents[2] / "README.md").read_text()
BLOCK = re.compile(r"```(\w+)\n(.*?)```", re.S)


def test_its_lines_run_as_they_stand(tmp_path, monkeypatch):
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    [code] = [body for language, body in BLOCK.findall(TEXT) if language == "python"]
    names = {}
    try:
        exec(compile(code, "README.md", "exec"), names)
    finally:
        plt.close("all")
    assert 0.8 * names["bound"] < np.abs(names["f_hat"] - names["f"]).max() < names["bound"]
    assert (tmp_path / "force.png").stat().st_size > 10_000
    assert (tmp_path / "firmware" / "phyfilter.c").is_file()


def test_it_is_read_in_minutes():
    assert 600 <= len(BLOCK.sub("", TEXT).split()) <= 800
