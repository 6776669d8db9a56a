"""The loop that a filter is learned for, from the command line."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from .wording import in_options

if TYPE_CHECKING:
    from ..design.learning import LoopGoal

__all__ = ["add_loop", "loop_of"]


def add_loop(parser: argparse.ArgumentParser) -> None:
    """Add the options of the loop."""
    loop = parser.add_argument_group("the loop that f_hat is fed back in")
    loop.add_argument(
        "--margin", type=float, metavar="M", help="modulus margin to keep there, in [0, 1); 0.5 is usual"
    )
    loop.add_argument(
        "--tracking",
        action="store_true",
        help="least tracking error in that loop, instead of least error of f_hat",
    )
    loop.add_argument("--lag", type=float, metavar="S", help="first-order lag of the actuator in s")
    loop.add_argument("--loop-delay", type=float, default=0.0, metavar="S", help="delay of the command in s")
    loop.add_argument("--kp", type=float, default=0.0, metavar="K", help="outer gain on position, 1/s^2")
    loop.add_argument("--kd", type=float, default=0.0, metavar="K", help="outer gain on velocity, 1/s")


def loop_of(options: argparse.Namespace) -> LoopGoal | None:
    """What the filter must keep in the loop; None without a margin.

    Raises
    ------
    ValueError
        For a loop without a margin, or a number out of range.
    """
    from ..design.learning import LoopGoal
    from ..values import Loop

    if options.margin is None:
        if options.tracking or options.lag is not None or options.loop_delay or options.kp or options.kd:
            raise ValueError(
                "--tracking, --lag, --loop-delay, --kp, --kd: expected --margin too, what the filter must keep there"
            )
        return None
    try:
        return LoopGoal(
            Loop(options.kp, options.kd, actuator=options.lag, delay=options.loop_delay),
            modulus_margin=options.margin,
            cost="tracking" if options.tracking else "estimation",
        )
    except ValueError as error:  # --delay is another one
        raise ValueError(in_options(str(error), options.known - {"--delay"})) from error
