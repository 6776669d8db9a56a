"""A log in a file, and as a table."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from . import checks
from .columns import VELOCITIES, default_columns, inertia_option, read_log
from .csvfile import write_csv
from .recorded import Recorded

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Stored(Recorded):
    """A log that is read and written; see :class:`Recording`."""

    @classmethod
    def from_csv(
        cls,
        path: str | os.PathLike[str],
        *,
        time: str | None = "t",
        dt: float | None = None,
        x: Sequence[str] = VELOCITIES,
        label: Sequence[str] | EllipsisType | None = ...,
        g: Sequence[str] | EllipsisType | None = ...,
        f_theta: Sequence[str] | EllipsisType | None = ...,
        features: Sequence[str] | EllipsisType | None = ...,
        inertia: ArrayLike | EllipsisType | None = ...,
        scale: Mapping[str, float] | None = None,
        delimiter: str = ",",
        unit: str | None = None,
    ) -> Self:
        """A log from a CSV file: a header line with the column names, then one row a sample.

        The columns are those of :meth:`Recording.read`, which knows other dialects, units and formats too; the names
        are taken to the letter, and times are the column ``t``.

        time and x must be there; the others are taken where the file has them. Lines that begin with ``#`` are
        comments, blank lines are skipped, a byte-order mark is allowed.

        Parameters
        ----------
        path : str or path-like
            UTF-8 text.
        time : str, optional
            Column of the times in s.
        dt : float, optional
            Sampling interval in s, for a file without times: with ``time=None``, and only then.
        x : sequence of str
            Columns of x.
        label, g, f_theta, features : sequence of str, optional
            Columns of the signal; None leaves it out; not given: the ones in the table, where the file has them.
        inertia : array_like of numbers or of column names, optional
            M, constant, as for the class; or the names of its n_x columns (diagonal) or n_x^2 (matrix, row by row).
        scale : mapping of str to float, optional
            Factors that columns are multiplied with to come to the units above, such as ``{"t": 1e-3}`` for ms.
        delimiter : str
            One character.
        unit : str, optional
            Unit of x; None means m/s for the default columns, else none.

        Returns
        -------
        Recording
            Called like the file, without its suffix, its channels like the columns of x.

        Raises
        ------
        OSError
            If the file cannot be read.
        ValueError
            If the file is empty, holds a header only or no UTF-8 text, names a column twice or lacks a column; if a
            row is broken, a value is not finite, or a time stands still or runs back: the number of the line in the
            file (from 1), the column and the text are named.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> from phyfilter_ctl.recording import Recording
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "short.csv"
        ...     _ = path.write_text("ms,v,a\\n0,1.0,0.5\\n10,1.005,0.5\\n")
        ...     Recording.from_csv(path, time="ms", x=["v"], label=["a"], scale={"ms": 1e-3}, unit="m/s")
        Recording('short': 2 samples of v [m/s], 0.01 s, dt 0.01 s; label)
        """
        path = Path(path)
        if (time is None) == (dt is None):
            raise ValueError(
                "expected exactly one of time (a column) and dt (with time=None), got "
                + ("neither" if dt is None else f"time={time!r} and dt={dt!r}")
            )
        columns, constant = inertia_option(inertia)
        log = read_log(
            path,
            time=time,
            x=x,
            signals={"label": label, "g": g, "f_theta": f_theta, "features": features, "inertia": columns},
            scale=scale or {},
            delimiter=delimiter,
        )
        values = {"inertia": constant, **log.values}
        times = values.pop("time", None)
        return cls.from_arrays(
            **values,
            times=times,
            dt=dt,
            name=path.stem,
            channels=log.x_names,
            unit=("m/s" if log.x_names == VELOCITIES else "") if unit is None else unit,
        )

    def to_csv(
        self,
        path: str | os.PathLike[str],
        *,
        time: str = "t",
        delimiter: str = ",",
        extra: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Write the log so that :meth:`from_csv` with ``x=log.channels`` reads the same numbers, bit for bit.

        The columns are those of the table in :meth:`Recording.read`. A constant inertia is written on every row;
        ``name`` and ``unit`` are not written.

        Parameters
        ----------
        path : str or path-like
        time : str
            Column of the times.
        delimiter : str
            One character.
        extra : mapping of str to (N,) array_like, optional
            Further columns, which reading does not look at.

        Raises
        ------
        ValueError
            If two columns would have one name, or an extra one has another length.
        OSError
            If the file cannot be written.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> from phyfilter_ctl.recording import Recording
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "log.csv"
        ...     Recording.from_arrays(x=[[0.5], [0.25]], dt=0.1, channels=["v"], g=[[1.0], [2.0]]).to_csv(path)
        ...     print(path.read_text(), end="")
        t,v,g_v
        0.0,0.5,1.0
        0.1,0.25,2.0
        """
        header, blocks = self._table()
        for name, values in (extra or {}).items():
            header.append(name)
            blocks.append(_signals.array(f"extra[{name!r}]", values, (self.n,), beside="x")[:, None])
        write_csv(Path(path), [time, *header], np.hstack([self.times[:, None], *blocks]), delimiter)

    def to_pandas(self, *, copy: bool = True) -> DataFrame:
        """The log as a pandas DataFrame: one row a sample, the times in s as its index ``t``.

        The columns are those of :meth:`to_csv`. ``name`` and ``unit`` are in its ``attrs``. Back again:
        ``Recording(frame.index, frame[list(log.channels)], ...)``.

        Parameters
        ----------
        copy : bool
            False: the columns are views of the log, which is frozen. Nothing is copied, and pandas refuses to write
            single entries of them; a new column, or a whole one, may be set.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        ImportError
            If pandas is not installed.
        ValueError
            If two columns would have one name.

        Examples
        --------
        >>> from phyfilter_ctl.recording import Recording
        >>> log = Recording.from_arrays(x=[0.5, 0.25], dt=0.1, channels=["v"], g=[1.0, 2.0])
        >>> log.to_pandas()  # doctest: +SKIP
                v  g_v
        t
        0.0  0.50  1.0
        0.1  0.25  2.0
        """
        try:
            import pandas
        except ImportError:
            raise ImportError(
                "to_pandas needs the package pandas: pip install 'phyfilter-ctl[containers]'"
            ) from None
        header, blocks = self._table()
        if len(set(header)) < len(header):
            raise ValueError(f"to_pandas: expected different columns, got {header}; give other channels")
        index = pandas.Index(self.times, name="t", copy=copy)
        columns = (column for block in blocks for column in block.T)
        frame = pandas.DataFrame(dict(zip(header, columns, strict=True)), index=index, copy=copy)
        frame.attrs.update(name=self.name, unit=self.unit)
        return frame

    def _table(self) -> tuple[list[str], list[FloatArray]]:
        """Names of all columns but the time, and the columns, an inertia on every row."""
        inertia = None if self.inertia is None else checks.inertia_rows(self.inertia, self.n, self.n_x)
        written = {"label": self.label, "g": self.g, "f_theta": self.f_theta, "features": self.features}
        header, blocks = [*self.channels], [self.x]
        for key, value in (*written.items(), ("inertia", inertia)):
            if value is not None:
                header += default_columns(key, self.channels, value.shape[1])
                blocks.append(value)
        return header, blocks
