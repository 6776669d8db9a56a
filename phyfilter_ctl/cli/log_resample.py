"""``phyfilter-ctl log resample``: a recording at equal steps."""

from __future__ import annotations

import argparse

from .._output import add_json, check_target, write_json
from .columns import add_columns, plausibility, read_columns

__all__ = ["add_arguments", "main"]

_DESCRIPTION = """A recording at equal steps, by straight lines between its samples; g by the sample before, unless
--g-rule is average. Nothing is filtered before: content faster than the new rate aliases. Gaps are bridged."""

_EPILOG = """examples:
  phyfilter-ctl log resample flight.csv --dt 0.01 --out even.csv
  phyfilter-ctl log resample joints.csv --x dq1,dq2 --dt 0.002 --out even.csv"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl log resample``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("file", metavar="FILE.csv", help="a recording")
    parser.add_argument("--out", required=True, metavar="FILE.csv", help="where it goes")
    add_json(parser)
    add_columns(parser, dt="new sampling interval in s (default: the median step)")


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl log resample``; return the exit status.

    Raises
    ------
    ValueError, OSError
        If the options or the recording are wrong, or a file cannot be read or written.
    """
    check_target(options.out, suffixes=(".csv",))
    dt, options.dt = options.dt, None  # of the new recording
    log = read_columns(options.file, options)
    doubts = plausibility([log], options)
    even = log.resample(log.dt if dt is None else dt, g="hold" if options.g_rule == "hold" else "linear")
    even.to_csv(options.out)
    if options.json is not None:
        read, written = ({"samples": each.n, "dt": each.dt} for each in (log, even))
        write_json(
            options.json, {"channels": log.channels, "read": read, "written": written, "findings": doubts}
        )
    if options.json != "-":
        print(f"{log!r}\n{even!r}")
    return 0
