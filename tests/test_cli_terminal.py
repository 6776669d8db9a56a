"""On a terminal, a real one: bars only there, no colours where NO_COLOR asks for none, nothing under --quiet."""

from __future__ import annotations

import os
import re
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from phyfilter_ctl.cli import main
from phyfilter_ctl.study import Outputs

pty = pytest.importorskip("pty", reason="needs the terminals of POSIX")
termios = pytest.importorskip("termios", reason="needs the terminals of POSIX")

COLOUR = re.compile(r"\x1b\[[0-9;]*m")


@pytest.fixture
def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], object]], str]:
    """What work writes where standard output and standard error are a terminal."""

    def shown(work: Callable[[], object]) -> str:
        master, slave = pty.openpty()
        termios.tcsetwinsize(slave, (24, 100))
        parts: list[bytes] = []

        def read() -> None:
            try:
                while part := os.read(master, 4096):
                    parts.append(part)
            except OSError:  # Linux's end of a terminal that nobody writes to any more
                pass

        reader = threading.Thread(target=read)
        with open(slave, "w") as terminal, monkeypatch.context() as patch:
            assert terminal.isatty()
            patch.setattr(sys, "stdout", terminal)
            patch.setattr(sys, "stderr", terminal)
            reader.start()
            work()
        reader.join(10.0)
        os.close(master)
        return b"".join(parts).decode()

    return shown


def steps(*, quiet: bool) -> None:
    with Outputs(quiet=quiet).progress(2) as say:
        say("first flight")
        say("second flight")


def test_bars_are_drawn_on_a_terminal_only(on_terminal, capfd) -> None:
    drawn = on_terminal(lambda: steps(quiet=False))
    assert "first flight" in drawn
    assert "/2" in drawn
    assert not COLOUR.search(drawn)
    assert on_terminal(lambda: steps(quiet=True)) == ""
    steps(quiet=False)
    assert capfd.readouterr() == ("", "")


def test_no_color_is_heeded(on_terminal, monkeypatch) -> None:
    """By the help, which Python 3.14 colours, and by a command's figures."""
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.delenv("FORCE_COLOR", raising=False)

    def helped() -> None:
        with pytest.raises(SystemExit) as ended:
            main(["design", "--help"])
        assert ended.value.code == 0

    shown = on_terminal(helped)
    assert "--poles" in shown
    assert not COLOUR.search(shown)
    shown = on_terminal(lambda: main(["design", "--poles", "-20", "--picture", "none"]))
    assert "F(s)" in shown
    assert "\x1b" not in shown


def test_a_command_says_what_it_wrote_and_how_it_ended(on_terminal, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    design = ["design", "--poles", "-20", "--picture", "none", "--out", "filter.toml"]
    assert "wrote filter.toml" in on_terminal(lambda: main(design))
    assert "wrote" not in on_terminal(lambda: main([*design, "--quiet"]))
    ends: list[int] = []
    shown = on_terminal(lambda: ends.append(main(["analyze", "absent.toml"])))
    assert ends == [2]
    assert len(shown.splitlines()) == 1
