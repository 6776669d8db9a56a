"""The page "your own legged robot" does what it says."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_page_runs_and_the_filter_takes_the_sag(monkeypatch, capsys):
    pytest.importorskip("mujoco", reason="needs the extra mujoco")
    monkeypatch.chdir(ROOT)
    [code] = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "your_legged_robot.md").read_text(), re.S)
    assert sum(bool(line.strip()) for line in code.splitlines()) <= 30
    found: dict[str, float] = {}
    exec(compile(code, "docs/your_legged_robot.md", "exec"), found)
    sag, rest = (found["wanted"] - found[name] for name in ("without", "with_filter"))
    assert sag > 0.015
    assert 0.0 < rest < 0.3 * sag, "what is left is the legs' dry friction"
    assert "wanted" in capsys.readouterr().out
