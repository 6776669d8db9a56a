"""A robot: what turns its raw logs into recordings of M x' = g + f."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import TYPE_CHECKING, Self

from . import document
from .checking import checked
from .expressions import Expression, Functions
from .mechanism import Mechanism
from .reading import Reading

if TYPE_CHECKING:
    from ..filterfile.table import TomlTable
    from ..logfiles import LogFile
    from ..recording import Check

__all__ = ["Robot"]


@dataclass(frozen=True, eq=False, repr=False)
class Robot(Reading):
    """A robot as its file describes it; made by :meth:`load`.

    Attributes
    ----------
    path : Path
        The file; a learned model and a mechanism are looked for beside it.
    preset : str
        Name of the preset it stands on; empty: none.
    name : str
    time_unit, time : str
        Unit (s, ms, us, ns) and name of the column of times of a table that does not say them itself; else empty.
    constants : mapping
        Numbers, vectors and matrices by name, in SI units.
    clocks : mapping of str to float
        s to add to the stamps of a topic, to bring all clocks together.
    signals : mapping of str to RobotSignal
    expressions : mapping of str to str
        Of signals, constants and one another.
    model : mapping
        x, M, g, f_theta, label, features: expressions; clock, channels, unit, f_theta_file.
    functions : mapping
        What expressions may call beside the usual ones: those of its mechanism.
    """

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a robot file.

        Parameters
        ----------
        path : str or path-like
            TOML, see the page "Your own robot" for all that it may hold.

        Raises
        ------
        OSError
            If the file cannot be read.
        ValueError
            If it is no TOML, no robot file, of another version, has an unknown key, lacks one, or has an expression
            that is not allowed or names what there is not: the file and the key are named.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> from phyfilter_ctl.robot import Robot
        >>> text = '''
        ... format = "phyfilter-robot"
        ... version = 1
        ... constants = { mass = 2.0 }
        ... signals.v = { field = "v", unit = "km/h" }
        ... signals.force = { field = "u", unit = "N", between = "hold" }
        ... model = { x = "v", M = "mass", g = "force", unit = "m/s" }
        ... '''
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "robot.toml"
        ...     _ = path.write_text(text)
        ...     Robot.load(path)
        Robot('robot': x = v, M = mass, g = force; signals v, force)
        """
        path = Path(path)
        top, preset = document.tables_of(path)

        def entries(key: str) -> Mapping[str, object]:
            return top.table(key).values if key in top else {}

        unit = top.text("time_unit") if "time_unit" in top else ""
        if unit not in ("", "s", "ms", "us", "ns"):
            raise top.error("time_unit", f"expected one of s, ms, us, ns, got {unit!r}")
        robot = cls(
            path=path,
            preset=preset,
            name=top.text("name") if "name" in top else path.stem,
            time_unit=unit,
            time=top.text("time") if "time" in top else "",
            constants={k: top.table("constants").numbers_of_any_shape(k) for k in entries("constants")},
            clocks={k: top.table("clocks").number(k) for k in entries("clocks")},
            signals={k: document.signal_of(top.table("signals").table(k)) for k in entries("signals")},
            expressions={k: top.table("expressions").text(k) for k in entries("expressions")},
            model={
                k: tuple(top.table("model").texts(k)) if k == "channels" else top.table("model").text(k)
                for k in entries("model")
            },
            functions=_functions(top),
        )
        robot._check(top)
        return robot

    def check(self, log: str | os.PathLike[str] | LogFile) -> Check:
        """Read a log and say what is not plausible about it, with what to do.

        Parameters
        ----------
        log : str, path-like or LogFile

        Returns
        -------
        Check
            The recording, the findings, and how well each convention of the frames fits.

        Raises
        ------
        OSError, ValueError
            As for :meth:`read`.
        """
        return checked(self, self.opened(log))

    def _check(self, top: TomlTable) -> None:
        known = (*self.constants, *self.signals, *self.expressions)
        for table, names in (("signals", self.signals), ("expressions", self.expressions)):
            for name in names:
                if not name.isidentifier() or known.count(name) > 1:
                    what = "is given twice" if known.count(name) > 1 else "is no name: letters, digits and _"
                    raise top.error(f"{table}.{name}", what)
        if "x" not in self.model:
            raise top.error("model.x", "missing: the measured signal, an expression")
        for where, text in self._texts.items():
            try:
                names = Expression(text, self.functions).names
            except ValueError as error:
                raise top.error(where, str(error)) from error
            for name in sorted(names - set(known)):
                raise top.error(where, f"unknown name {name!r}; {document.nearest(name, known)}")
        try:
            tuple(TopologicalSorter({k: self._needs[k] for k in self.expressions}).static_order())
        except CycleError as error:
            raise top.error("expressions", f"{' needs '.join(error.args[1])}: a circle") from error
        if "f_theta_file" in self.model and "features" not in self.model:
            raise top.error("model.features", "missing: the inputs of the model in f_theta_file")
        if "f_theta" in self.model and "f_theta_file" in self.model:
            raise top.error("model.f_theta", "expected either an expression or f_theta_file, got both")
        if not self._bases([self._text("x")]):
            raise top.error("model.x", "expected an expression of at least one signal")

    def __repr__(self) -> str:
        parts = ", ".join(f"{k} = {self._text(k)}" for k in ("x", "M", "g", "f_theta") if k in self.model)
        return f"Robot({self.name!r}: {parts}; signals {', '.join(self.signals)})"


def _functions(top: TomlTable) -> Functions:
    if "mechanism" not in top:
        return {}
    table = top.table("mechanism")
    return Mechanism(top.file.parent / table.text("file"), table.texts("joints")).functions
