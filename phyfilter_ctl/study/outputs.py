"""Where the results of a job go: a table on the screen, figures as JSON, a picture."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .._output import add_json, add_quiet, check_folder, check_target, write_figure, write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..execution import Report

__all__ = ["Outputs", "add_output_options"]


def add_output_options(parser: ArgumentParser, name: str, *, description: str, examples: str) -> None:
    """Describe a job, and add ``--json``, ``--picture`` and ``--quiet``.

    Parameters
    ----------
    parser : ArgumentParser
    name : str
        Of the picture unless another is asked for, without its ending.
    description, examples : str
        Above and below the options.

    Examples
    --------
    >>> parser = ArgumentParser(prog="cart")
    >>> add_output_options(parser, "cart", description="Push a cart.", examples="cart --quiet")
    >>> Outputs.of(parser.parse_args(["--json", "-"]))
    Outputs(json='-', picture='cart.png', quiet=False, folder=None)
    """
    parser.description, parser.epilog = description, examples
    parser.formatter_class = RawDescriptionHelpFormatter
    output = parser.add_argument_group("output")
    add_json(output)
    output.add_argument(
        "--picture",
        metavar="FILE",
        default=f"{name}.png",
        help=f"png, pdf or svg (default {name}.png; none: no picture)",
    )
    add_quiet(output)


@dataclass(frozen=True)
class Outputs:
    """Where the results of a job go.

    Parameters
    ----------
    json : str, optional
        File of the figures, "-" for standard output instead of the table; None: none.
    picture : str, optional
        File of the picture; None: none.
    quiet : bool
        No progress bar.
    folder : str, optional
        Where the picture goes, made with it where it is not there; None: where the picture's own name says.

    Raises
    ------
    ValueError
        If a file could not be written, before any work is done.
    """

    json: str | None = None
    picture: str | None = None
    quiet: bool = False
    folder: str | None = None

    def __post_init__(self) -> None:
        check_target(self.json)
        if self.folder is not None:
            check_folder(self.folder)
        check_target(self.picture, suffixes=(".png", ".pdf", ".svg"))

    @classmethod
    def of(cls, options: Namespace) -> Outputs:
        """What the options of :func:`add_output_options` ask for.

        Parameters
        ----------
        options : Namespace
        """
        return cls(options.json, None if options.picture == "none" else options.picture, options.quiet)

    def progress(self, total: int) -> AbstractContextManager[Report]:
        """As :func:`progress`, unless quiet.

        Parameters
        ----------
        total : int
            Number of steps.
        """
        from ..execution import progress

        return progress(total, self.quiet)

    def publish(self, table: str, figures: object, draw: Callable[[], Figure] | None = None) -> None:
        """Print the table, write the figures and draw the picture, as far as each is asked for.

        Parameters
        ----------
        table : str
        figures : object
            For JSON, in which infinite numbers are "Infinity" and "-Infinity", null is what is not known.
        draw : function () -> Figure, optional
            Called only where there is a picture to write.
        """
        if self.json != "-":
            print(table)
        if self.json is not None:
            write_json(self.json, figures)
        if draw is not None and self.picture is not None:
            figure, path = draw(), Path(self.folder or "", self.picture)
            if self.folder is not None:
                path.parent.mkdir(exist_ok=True)
            write_figure(str(path), figure)
