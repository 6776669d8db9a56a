"""One instance of a compiled model, step by step: the functions of its C table."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .binding import Library, address
from .model import CModel

__all__ = ["Instance"]

Array = NDArray[np.floating]


class Instance:
    """One instance of a compiled model; one block of memory without pointers.

    Parameters
    ----------
    model : CModel
    library : Library

    Attributes
    ----------
    memory : (size,) array of bytes
        All of it: copy it to save the state, copy it back to restore it.
    address : int
        Where it begins.
    x, u, p : arrays
        Continuous states, inputs, and parameters as last set, in place.
    """

    def __init__(self, model: CModel, library: Library) -> None:
        self._model, self._library, self._table = model, library, library.table
        self.memory: NDArray[np.uint8] = np.zeros(self._table.size, np.uint8)
        self.address: int = self.memory.ctypes.data
        self.x: Array = library.view(self.memory, self._table.x(self.address), self._table.n_x)
        self.u: Array = library.view(self.memory, self._table.u(self.address), self._table.n_u)
        self.p: Array = library.view(self.memory, self._table.p(self.address), self._table.n_p)
        self._work = np.empty(library.work_reals, library.dtype)
        self.init()

    def init(self) -> None:
        """Start values of everything."""
        if self._table.init(self.address):
            raise RuntimeError(
                f"{self._model.name}: the compiler's flags give no IEEE arithmetic, see pf_ieee.h"
            )

    def set_parameters(self, params: Mapping[str, float] | ArrayLike) -> None:
        """Puts parameters in force, all or none.

        Parameters
        ----------
        params : mapping of str to float, or (n_p,) array
            By name, or all.

        Raises
        ------
        ValueError
            If a name or the shape is wrong, or the model refuses the values; then nothing has changed.
        """
        names = [variable.name for variable in self._model.parameters]
        values = self.p.astype(np.float64)
        if isinstance(params, Mapping):
            for name, value in params.items():
                if name not in names:
                    raise ValueError(f"params: {self._model.name} has no parameter {name!r}; it has {names}")
                values[names.index(name)] = value
        else:
            values = _signals.array(
                "params", params, (len(names),), beside=f"the parameters {names}", finite=False
            )
        self.p[:] = values
        refusal = self._table.apply(self.address)
        if refusal is not None:
            raise ValueError(f"params: {self._model.name} refuses them: {refusal.decode()}")

    def set_sampled_states(self, values: ArrayLike) -> None:
        """States of the sampled blocks, (n_s,), those of a PhyFilter excepted.

        Parameters
        ----------
        values : (n_s,) array

        Raises
        ------
        ValueError
            If the shape is wrong.
        """
        s = np.ascontiguousarray(values, dtype=self._library.dtype)
        if s.shape != (self._table.n_s,):
            raise ValueError(f"sampled_state: expected shape ({self._table.n_s},), got {s.shape}")
        self._library.set_states(self.address, address(s))

    def sampled_states(self) -> Array:
        """States of the sampled blocks, (n_s,)."""
        s = np.empty(self._table.n_s, self._library.dtype)
        self._table.s(self.address, address(s))
        return s

    def start(self, t: float) -> int:
        """First sample of all sampled blocks; a status.

        Parameters
        ----------
        t : float
            Seconds.
        """
        return int(self._table.start(self.address, t))

    def next(self) -> float:
        """Next instant of a sampled block in seconds; 1e300 if there is none."""
        return float(self._table.next(self.address))

    def sample(self, t: float) -> int:
        """Runs the sampled blocks of the earliest instant at or before t; a status.

        Parameters
        ----------
        t : float
            Seconds.
        """
        return int(self._table.sample(self.address, t, address(self.x)))

    def derivatives(self, t: float) -> Array:
        """x' at the state and inputs in place, (n_x,).

        Parameters
        ----------
        t : float
            Seconds.

        Raises
        ------
        RuntimeError
            If a Newton iteration does not converge.
        """
        dx = np.empty(self._table.n_x, self._library.dtype)
        self._check(self._table.derivatives(self.address, t, address(self.x), address(dx)))
        return dx

    def outputs(self, t: float) -> Array:
        """y at the state and inputs in place, (n_y,).

        Parameters
        ----------
        t : float
            Seconds.

        Raises
        ------
        RuntimeError
            If a Newton iteration does not converge.
        """
        y = np.empty(self._table.n_y, self._library.dtype)
        self._check(self._table.outputs(self.address, t, address(self.x), address(y)))
        return y

    def directional(self, t: float, x: ArrayLike, u: ArrayLike, p: ArrayLike) -> tuple[Array, Array]:
        """Derivative of x' and y along a seed.

        Parameters
        ----------
        t : float
            Seconds.
        x, u, p : (n_x,), (n_u,) and (n_p,) arrays
            The seed.

        Returns
        -------
        (n_x,) and (n_y,) arrays

        Raises
        ------
        RuntimeError
            If the model was made without, or a Newton iteration does not converge.
        """
        dx, y = self._product("directional", t, (x, u, p), (self._table.n_x, self._table.n_y))
        return dx, y

    def adjoint(self, t: float, dx: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """Derivative of dx . x' + y . y by x, u and p.

        Parameters
        ----------
        t : float
            Seconds.
        dx, y : (n_x,) and (n_y,) arrays
            The cotangent.

        Returns
        -------
        (n_x,), (n_u,) and (n_p,) arrays

        Raises
        ------
        RuntimeError
            If the model was made without, or a Newton iteration does not converge.
        """
        lengths = (self._table.n_x, self._table.n_u, self._table.n_p)
        to_x, to_u, to_p = self._product("adjoint", t, (dx, y), lengths)
        return to_x, to_u, to_p

    def advance(
        self,
        t: float,
        t_end: float,
        *,
        slope: ArrayLike | None = None,
        method: Literal["rk4", "adaptive"] = "rk4",
        max_step: float = 0.0,
        rtol: float = 1e-8,
        atol: float = 1e-10,
    ) -> tuple[int, float]:
        """From t to t_end, the instants after t up to t_end included.

        Parameters
        ----------
        t, t_end : float
            Seconds.
        slope : (n_u,) array, optional
            Rates of the inputs; constant without.
        method : {"rk4", "adaptive"}
        max_step : float
            Seconds; 0: RK4 from stop to stop in one step.
        rtol, atol : float
            Of the adaptive method.

        Returns
        -------
        status, t_reached
            0 and t_end if all went well.
        """
        rates = None if slope is None else np.ascontiguousarray(slope, dtype=self._library.dtype)
        solver = self._library.solver(0 if method == "rk4" else 1, max_step, rtol, atol)
        reached = ct.c_double()
        status = self._library.advance(
            self.address, address(self._work), ct.byref(solver), t, t_end, address(rates), ct.byref(reached)
        )
        return int(status), reached.value

    def _product(
        self, name: str, t: float, seeds: tuple[ArrayLike, ...], lengths: tuple[int, ...]
    ) -> tuple[Array, ...]:
        function = getattr(self._table, name)
        if not function:
            raise RuntimeError(
                f"{self._model.name} was made without {name} products; compile it with derivatives=True"
            )
        given = [np.ascontiguousarray(seed, dtype=self._library.dtype) for seed in seeds]
        results = tuple(np.empty(length, self._library.dtype) for length in lengths)
        self._check(function(self.address, t, *map(address, given), *map(address, results)))
        return results

    def _check(self, status: int) -> None:
        if status:
            raise RuntimeError(
                f"{self._model.name}: a Newton iteration in it does not converge at this point"
            )
