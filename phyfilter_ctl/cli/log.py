"""``phyfilter-ctl log``: what a robot's log holds."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, get_args

from .._choices import TimeUnit
from .._output import add_json, write_json
from .columns import add_largest

if TYPE_CHECKING:
    from ..logfiles import LogFile, Topic

__all__ = ["add_arguments", "main"]

_DESCRIPTION = """What a robot's log holds: topics with fields, units, rates, gaps and jumps of their clocks, and which
of them may be x, g and a label. PX4 (.ulg), ArduPilot (.bin), ROS 1 and 2 bags, MCAP, Crazyflie, Parquet, Arrow,
Feather, HDF5, .mat, CSV; told by the first bytes."""

_EPILOG = """examples:
  phyfilter-ctl log flight.ulg
  phyfilter-ctl log table.csv --time-unit us --time stamp   a table whose column stamp counts microseconds
  phyfilter-ctl log bag_folder --json -                     all of it, for a program
  phyfilter-ctl log flight.ulg --describe > robot.toml      a first robot file: what its signals are"""

_LISTED = 12  # fields of a topic that are shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl log``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("file", metavar="FILE", help="a log; for a ROS 2 bag its folder")
    parser.add_argument(
        "--time-unit", choices=get_args(TimeUnit), help="what a table's times count, where it does not say it"
    )
    parser.add_argument(
        "--time", metavar="COLUMN", help="a table's column of times (default: the one called so)"
    )
    add_largest(parser)
    output = parser.add_mutually_exclusive_group()
    add_json(output)
    output.add_argument(
        "--describe", action="store_true", help="print a first robot.toml for it instead, to be filled in"
    )


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl log``; return the exit status.

    Raises
    ------
    ValueError, OSError
        If the file cannot be read, or its unit of time has to be given.
    """
    from ..logfiles import open_log
    from ..robot import describe_log

    log = open_log(options.file, time_unit=options.time_unit, time=options.time, largest=options.largest)
    if options.describe:
        print(describe_log(log), end="")
    else:
        if options.json is not None:
            write_json(options.json, _figures(log))
        if options.json != "-":
            print(_text(log))
    return 0


def _figures(log: LogFile) -> dict[str, object]:
    """What the JSON holds."""
    from ..logfiles.suggesting import suggestions
    from ..results import plain

    return {
        "path": str(log.path),
        "format": log.format,
        "start": log.start and log.start.isoformat(),
        "notes": log.notes,
        "dropouts": log.dropouts,
        "topics": [{**plain(topic, infinite=True), "findings": topic.clock.findings} for topic in log.topics],
        "suggestions": suggestions(log),
    }


def _text(log: LogFile) -> str:
    from ..logfiles.suggesting import suggestions

    spans = [topic.clock.last for topic in log.topics if topic.count]
    lines = [f"{log.path}: {log.format}, topics: {len(log.topics)}, {max(spans, default=0.0):.6g} s"]
    lines.append(f"time 0 is {log.start.isoformat() if log.start else 'of an unknown date'}")
    lines += log.notes
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts)
        lines.append(f"! dropouts: {len(log.dropouts)}, {lost:.3g} s in all")
    width = max(len(topic.name) for topic in log.topics)
    lines += ["", f"{'topic':{width}}  samples       Hz     from s      to s  fields"]
    for topic in log.topics:
        lines += _topic(topic, width)
    if found := suggestions(log):
        lines += ["", "may serve as"]
        lines += [f"  {s.signal:5}  {s.topic}: {', '.join(s.fields)}: {s.why}" for s in found]
    return "\n".join(lines)


def _topic(topic: Topic, width: int) -> list[str]:
    fields = [
        f"{field.name}{''.join(f'[{k}]' for k in field.shape)}{f' ({field.unit})' if field.unit else ''}"
        for field in topic.fields
    ]
    shown = ", ".join(fields[:_LISTED]) + (f", {len(fields) - _LISTED} more" if len(fields) > _LISTED else "")
    clock = topic.clock
    row = f"{topic.name:{width}}  {topic.count:7}  {1.0 / clock.dt:7.4g}  {clock.first:9.6g} {clock.last:9.6g}  {shown}"
    return [row, *(f"  ! {finding}" for finding in clock.findings), *(f"  {note}" for note in topic.notes)]
