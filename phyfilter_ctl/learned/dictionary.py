"""The functions that a Koopman model is linear in."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from itertools import combinations_with_replacement
from math import comb
from typing import Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from . import _arrays
from ._least_squares import ridge
from .layers import standardisation

# Most functions: a Gram matrix then has 2 MB, and its inversion in every step stays possible.
_MOST_TERMS = 512


@dataclass(frozen=True, eq=False, repr=False)
class Dictionary:
    """Monomials up to a total degree and Gaussian radial functions of scaled features.

        psi(z) = [1, s_1, ..., s_n, s_1^2, s_1 s_2, ..., exp(-|s - c_j|^2 / (2 width^2)), ...],
        s = (z - offset) / scale,   c_j = (centre_j - offset) / scale

    Parameters
    ----------
    n_z : int
        Number of features.
    degree : int
        Highest total degree of the monomials; 0 leaves the constant.
    centres : array_like, shape (n_c, n_z), optional
        Centres of the radial functions, in the units of z; none if None.
    width : float
        Width of the radial functions, in scaled units.
    offset, scale : array_like, shape (n_z,), optional
        Middle and size of each feature; 0 and 1 if None. :meth:`scaled_to` takes them from data.

    Raises
    ------
    ValueError, TypeError
        If an option is out of range, shapes do not fit together, or there are more than 512 functions.

    Examples
    --------
    >>> Dictionary(2, degree=2)([[2.0, 3.0]]).tolist()
    [[1.0, 2.0, 3.0, 4.0, 6.0, 9.0]]
    """

    n_z: int
    _: KW_ONLY
    degree: int = 2
    centres: FloatArray | None = None
    width: float = 1.0
    offset: FloatArray | None = None
    scale: FloatArray | None = None

    def __post_init__(self) -> None:
        _signals.count("n_z", self.n_z)
        _signals.count("degree", self.degree, 0)
        _arrays.number("width", self.width, positive=True)
        for name, default in (("offset", np.zeros), ("scale", np.ones)):
            given = getattr(self, name)
            array = _arrays.frozen(name, default(self.n_z) if given is None else given, (self.n_z,))
            object.__setattr__(self, name, array)
        if not np.all(self._scale > 0.0):
            raise ValueError(f"scale: expected numbers > 0, got {self._scale.tolist()}")
        given = np.zeros((0, self.n_z)) if self.centres is None else self.centres
        object.__setattr__(self, "centres", _arrays.frozen("centres", given, (-1, self.n_z)))
        if self.size > _MOST_TERMS:
            raise ValueError(
                f"degree: {self.n_z} features make {self.size} functions, more than {_MOST_TERMS}; lower degree, or "
                "use fewer features or centres"
            )

    @property
    def size(self) -> int:
        """Number m of functions."""
        return comb(self.n_z + self.degree, self.degree) + len(self._centres)

    def scaled_to(self, z: ArrayLike) -> Self:
        """Return the dictionary with the mean and standard deviation of the rows z (N, n_z) as offset and scale.

        Raises
        ------
        ValueError, TypeError
            If ``z`` is not a finite real array of shape (N, n_z).
        """
        offset, scale = standardisation("z", _arrays.rows("z", z, self.n_z))
        return replace(self, offset=offset, scale=scale)

    def __call__(self, z: ArrayLike) -> FloatArray:
        """psi at z (N, n_z), shape (N, m)."""
        z = _arrays.rows("z", z, self.n_z)
        s, centres = (z - self._offset) / self._scale, (self._centres - self._offset) / self._scale
        psi = np.empty((len(z), self.size))
        psi[:, 0] = 1.0
        for i, (parent, column) in enumerate(self._products(), start=1):
            np.multiply(psi[:, parent], s[:, column], out=psi[:, i])
        for i, centre in enumerate(centres, start=self.size - len(centres)):
            psi[:, i] = np.exp(-np.sum((s - centre) ** 2, axis=1) / (2.0 * self.width**2))
        return psi

    def expression(self, z: ca.SX) -> ca.SX:
        """Psi at one sample z (n_z, 1)."""
        s = (z - ca.DM(self._offset)) / ca.DM(self._scale)
        psi = [ca.SX(1)]
        for parent, column in self._products():
            psi.append(psi[parent] * s[column])
        centres = (self._centres - self._offset) / self._scale
        radial = (ca.exp(-ca.sumsqr(s - ca.DM(c)) / (2.0 * self.width**2)) for c in centres)
        return ca.vertcat(*psi, *radial)

    def operator(self, z: ArrayLike, *, l2: float = 0.0) -> FloatArray:
        """Extended dynamic mode decomposition: K (m, m) with psi(z_{k+1}) = K' psi(z_k) in least squares.

        Its eigenvalues are exp(lambda h) for the modes lambda of the motion where psi spans an invariant subspace
        (M. O. Williams, I. G. Kevrekidis, C. W. Rowley, J. Nonlinear Sci. 25, 2015).

        Parameters
        ----------
        z : array_like, shape (N, n_z)
            Consecutive samples, N >= 2.
        l2 : float
            Weight of the penalty l2 |K|^2 beside the mean squared error.

        Raises
        ------
        ValueError, TypeError
            If ``z`` is not a finite real array of this shape or ``l2`` is negative.
        """
        psi = self(z)
        if len(psi) < 2:
            raise ValueError("z: expected at least 2 consecutive samples, got 1")
        return ridge(iter([(psi[:-1], psi[1:])]), _arrays.number("l2", l2), self.size)[0]

    def _products(self) -> list[tuple[int, int]]:
        """Every monomial but 1 as an earlier one times a feature."""
        place: dict[tuple[int, ...], int] = {(): 0}
        for total in range(1, self.degree + 1):
            for factors in combinations_with_replacement(range(self.n_z), total):
                place[factors] = len(place)
        return [(place[factors[:-1]], factors[-1]) for factors in place if factors]

    @property
    def _offset(self) -> FloatArray:
        assert self.offset is not None  # set in __post_init__, as the two below
        return self.offset

    @property
    def _scale(self) -> FloatArray:
        assert self.scale is not None
        return self.scale

    @property
    def _centres(self) -> FloatArray:
        assert self.centres is not None
        return self.centres

    def __repr__(self) -> str:
        return f"Dictionary({self.n_z}, degree={self.degree}, {len(self._centres)} centres, {self.size} functions)"
