"""``phyfilter-ctl log label``: the force of a recording from both sides, as its label."""

from __future__ import annotations

import argparse

from .._output import add_json, check_target, write_json
from .columns import add_columns, plausibility, read_columns

__all__ = ["add_arguments", "main"]

_DESCRIPTION = """The force f of M x' = g + f at every sample, from the samples before and after (Rauch, Tung,
Striebel), as a label for learn and for scores, with its standard deviation if f is a random walk and the noise of x
white. It comes out of x as every estimate does, so it shows no error that both share, such as a wrong g."""

_EPILOG = """examples:
  phyfilter-ctl log label flight.csv --out labelled.csv && phyfilter-ctl learn labelled.csv
  phyfilter-ctl log label joints.csv --x p1,p2 --g tau1,tau2 --noise 0.002 --out labelled.csv"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl log label``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("file", metavar="FILE.csv", help="a recording")
    parser.add_argument("--out", required=True, metavar="FILE.csv", help="where it goes")
    parser.add_argument("--noise", type=float, metavar="S", help="deviation of M x (default: the likeliest)")
    add_json(parser)
    add_columns(parser)


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl log label``; return the exit status.

    Raises
    ------
    ValueError, OSError
        If the options or the recording are wrong, or a file cannot be read or written.
    """
    check_target(options.out, suffixes=(".csv",))
    import numpy as np

    from ..estimation import smooth_label

    log = read_columns(options.file, options)
    doubts = plausibility([log], options)
    found = smooth_label(log, noise=options.noise, g=options.g_rule)
    extra = {f"deviation_{name}": found.deviation[:, i] for i, name in enumerate(log.channels)}
    found.recording.to_csv(options.out, extra=extra)
    if options.json is not None:
        figures = {
            "samples": log.n,
            "channels": log.channels,
            "deviation": np.median(found.deviation, axis=0),
            "noise": found.noise,
            "walk": found.walk,
            "findings": doubts,
        }
        write_json(options.json, figures)
    if options.json == "-":
        return 0
    print(repr(found.recording))
    for i, name in enumerate(log.channels):
        middle, walk = sorted(found.deviation[:, i])[log.n // 2], found.walk[i]
        print(
            f"  {name}: deviation {middle:.3g}, noise of M x {found.noise[i]:.3g}, walk {walk:.3g} per sqrt(s)"
        )
    print("\n".join(f"  {doubt}" for doubt in doubts), end="\n" if doubts else "")
    return 0
