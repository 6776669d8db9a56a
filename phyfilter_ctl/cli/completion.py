"""``phyfilter-ctl completion``: lines for a shell that complete its commands and options."""

from __future__ import annotations

import argparse

_EPILOG = """examples:
  phyfilter-ctl completion bash > ~/.local/share/bash-completion/completions/phyfilter-ctl
  phyfilter-ctl completion zsh > ~/.zsh/_phyfilter-ctl           # a folder that is in $fpath"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl completion``."""
    parser.description = "Print what completes phyfilter-ctl in a shell (extra completion)."
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"))


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl completion``; return the exit status.

    Raises
    ------
    ValueError
        If shtab is not installed.
    """
    from . import _parser

    try:
        import shtab
    except ModuleNotFoundError:
        raise ValueError("completion needs shtab: pip install 'phyfilter-ctl[completion]'") from None
    print(shtab.complete(_parser(None), options.shell))
    return 0
