"""What a filter of joint torques is told of the robot.

The equations of motion of a robot on a floating base, base rows first (the paper's Eq. of the quadruped leaves the base
out):

    [M_bb M_bj] [a_b ]   [0  ]   [c_b]   [k_b]   [0]
    [M_jb M_jj] [q'' ] = [tau] - [c_j] + [k_j] + [f]

with c the bias (Coriolis, gravity, less the passive forces) and k = J' F_c the contact. The base accelerations are
eliminated: with S = M_jb M_bb^{-1}

    (M_jj - S M_bj) q'' = tau - (c_j - S c_b) + (k_j - S k_b) + f            (Schur complement of the base block)

so that the filter stays with the joints and needs no base acceleration. A force that nobody knows of and that acts on
the base by f_b shows up in f as -S f_b.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ... import _signals

__all__ = ["Contact", "JointQuantities", "JointSpacePrior", "balanced_contact"]

FloatArray = NDArray[np.float64]
Inertia = Literal["full", "diagonal", "constant"]
Bias = Literal["full", "damping", "none"]
Contact = Literal["known", "estimated", "omitted"]
Base = Literal["fixed", "floating"]

# Quantities whose last axis is all degrees of freedom.
_ROWS = ("M", "bias", "contact_torque", "contact_estimate")


@dataclass(frozen=True, eq=False)
class JointQuantities:
    """What is known of one or many robots at one instant. Leading axes are robots; what no prior asks for may be None.

    n joints and n_v = n_b + n degrees of freedom, the n_b of the base first (n_b = 6, or 0 where the base is fixed).

    Parameters
    ----------
    qd : (..., n) array
        Joint velocities in rad/s.
    M : (..., n_v, n_v) array, optional
        Inertia matrix, symmetric and positive definite.
    bias : (..., n_v) array, optional
        c: Coriolis, centrifugal and gravity torques less the passive ones (springs, damping), in N m (N).
    contact_torque : (..., n_v) array, optional
        k = J' F_c of the true contact forces.
    contact_estimate : (..., n_v) array, optional
        Somebody's estimate of it, as ``balanced_contact`` gives.

    Raises
    ------
    ValueError
        For shapes that do not belong together.

    Examples
    --------
    >>> JointQuantities(np.zeros((4, 12)), bias=np.zeros((4, 18))).base
    6
    """

    qd: FloatArray
    M: FloatArray | None = None
    bias: FloatArray | None = None
    contact_torque: FloatArray | None = None
    contact_estimate: FloatArray | None = None

    def __post_init__(self) -> None:
        qd = np.asarray(self.qd, dtype=float)
        object.__setattr__(self, "qd", qd)
        if qd.ndim < 1 or not qd.shape[-1]:
            raise ValueError(f"qd: expected shape (..., n) with n joints, got {qd.shape}")
        n, sizes = qd.shape[-1], {}
        for name in _ROWS:
            value = getattr(self, name)
            if value is not None:
                array = np.asarray(value, dtype=float)
                object.__setattr__(self, name, array)
                sizes[name] = array.shape[-1] if array.ndim else 0
        M = self.M
        if M is not None and (M.ndim < 2 or M.shape[-1] != M.shape[-2] or M.shape[-1] < n):
            raise ValueError(f"M: expected shape (..., n_v, n_v) with n_v >= {n} joints, got {M.shape}")
        if sizes and len(set(sizes.values())) > 1:
            raise ValueError(f"expected the same number of degrees of freedom for all, got {sizes}")
        if sizes and min(sizes.values()) < n:
            raise ValueError(f"expected at least as many degrees of freedom as the {n} joints, got {sizes}")

    @property
    def base(self) -> int:
        """Degrees of freedom n_b that come before the joints."""
        for value in (self.M, self.bias, self.contact_torque, self.contact_estimate):
            if value is not None:
                return value.shape[-1] - self.qd.shape[-1]
        return 0


@dataclass(frozen=True, eq=False)
class JointSpacePrior:
    """Which of the quantities enter the model M q'' = g + f of the joints.

    Parameters
    ----------
    inertia : {"full", "diagonal", "constant"}
        The inertia matrix, its diagonal (of the joint block, local inertia only, as the paper simplifies it), or
        ``constant_inertia`` whatever the pose.
    bias : {"full", "damping", "none"}
        Bias torques in g: all of them, linear damping -``damping`` q' only, or none.
    contact : {"known", "estimated", "omitted"}
        J' F_c in g: the true one, ``contact_estimate``, or none: then f_hat carries it.
    base : {"fixed", "floating"}
        "floating": the base accelerations are eliminated (Schur complement), which needs M, bias and contact of all
        degrees of freedom. "fixed": the joint rows alone, as if the base did not accelerate.
    damping : float or (n,) array
        N m s/rad, for ``bias="damping"``.
    constant_inertia : float, (n,) or (n, n) array, optional
        kg m^2, for ``inertia="constant"``.

    Raises
    ------
    ValueError
        For unknown words, a constant inertia that is missing or not positive definite, negative damping, or a floating
        base without the full inertia matrix.

    Examples
    --------
    >>> prior = JointSpacePrior("constant", "damping", "omitted", constant_inertia=0.1, damping=0.5)
    >>> now = JointQuantities(np.array([1.0, -2.0]))
    >>> prior.known_torque(now, np.array([3.0, 3.0])).tolist()
    [2.5, 4.0]
    """

    inertia: Inertia = "full"
    bias: Bias = "full"
    contact: Contact = "known"
    base: Base = "fixed"
    damping: ArrayLike = 0.0
    constant_inertia: ArrayLike | None = None

    def __post_init__(self) -> None:
        words = {"inertia": Inertia, "bias": Bias, "contact": Contact, "base": Base}
        for name, choices in words.items():
            if getattr(self, name) not in get_args(choices):
                expected = ", ".join(get_args(choices))
                raise ValueError(f"{name}: expected one of {expected}, got {getattr(self, name)!r}")
        damping = _signals.real("damping", self.damping)
        if damping.ndim > 1 or not np.isfinite(damping).all() or np.any(damping < 0.0):
            raise ValueError(
                f"damping: expected 0 N m s/rad or more, one number or (n,), got {self.damping!r}"
            )
        if (self.inertia == "constant") != (self.constant_inertia is not None):
            raise ValueError(
                f"constant_inertia goes with inertia='constant', and only with it; got inertia={self.inertia!r} and "
                f"constant_inertia={self.constant_inertia!r}"
            )
        if self.base == "floating" and self.inertia != "full":
            raise ValueError(
                f"base='floating' eliminates the base with the full inertia matrix; got inertia={self.inertia!r}"
            )
        object.__setattr__(self, "damping", damping)
        if self.constant_inertia is not None:
            constant = _signals.real("constant_inertia", self.constant_inertia)
            if constant.ndim > 2 or (constant.ndim == 2 and constant.shape[0] != constant.shape[1]):
                raise ValueError(f"constant_inertia: expected a number, (n,) or (n, n), got {constant.shape}")
            object.__setattr__(self, "constant_inertia", _positive(constant, "constant_inertia"))

    def inertia_matrix(self, quantities: JointQuantities) -> FloatArray:
        """Inertia that the filter works with.

        Parameters
        ----------
        quantities : JointQuantities

        Returns
        -------
        (..., n, n) or (..., n) array
            (..., n) where it is diagonal; (n,) or (n, n) where it is constant.

        Raises
        ------
        ValueError
            If the matrix is missing, not positive definite, or of another size.
        """
        n = quantities.qd.shape[-1]
        if self.constant_inertia is not None:
            constant = np.asarray(self.constant_inertia)
            if constant.ndim and constant.shape[-1] != n:
                raise ValueError(f"constant_inertia: shape {constant.shape} for {n} joints")
            return np.broadcast_to(constant, (n,)) if constant.ndim < 2 else constant
        M = _needed(quantities.M, "M", f"inertia={self.inertia!r}")
        nb = quantities.base
        joints = M[..., nb:, nb:]
        if self.inertia == "diagonal":
            return _positive(np.diagonal(joints, axis1=-2, axis2=-1), "the diagonal of M")
        if self.base == "floating" and nb:
            joints = joints - self._elimination(M, nb) @ M[..., :nb, nb:]
        return _positive(joints, "M")

    def known_torque(self, quantities: JointQuantities, torque: ArrayLike) -> FloatArray:
        """g: the torque that the model expects to act.

        Parameters
        ----------
        quantities : JointQuantities
        torque : (..., n) array
            Motor torques in N m.

        Returns
        -------
        (..., n) array
            In N m.

        Raises
        ------
        ValueError
            If a quantity that the prior asks for is missing, or shapes do not fit.
        """
        n = quantities.qd.shape[-1]
        g = np.asarray(torque, dtype=float)
        if g.ndim and g.shape[-1] != n:
            raise ValueError(f"torque: expected shape (..., {n}) to go with qd, got {g.shape}")
        if self.bias == "damping":
            damping = np.asarray(self.damping)
            if damping.ndim and len(damping) != n:
                raise ValueError(f"damping: {len(damping)} values for {n} joints")
            g = g - damping * quantities.qd
        known = self._all_rows(quantities)
        if known is None:
            return g + np.zeros(quantities.qd.shape)
        nb = quantities.base
        joints = known[..., nb:]
        if self.base == "floating" and nb:
            M = _needed(quantities.M, "M", "base='floating'")
            joints = joints - np.matmul(self._elimination(M, nb), known[..., :nb, None])[..., 0]
        return g + joints

    def _all_rows(self, quantities: JointQuantities) -> FloatArray | None:
        """Contact less bias for all degrees of freedom; None where neither is in the model."""
        known = None
        if self.bias == "full":
            known = -_needed(quantities.bias, "bias", "bias='full'")
        if self.contact != "omitted":
            name = "contact_torque" if self.contact == "known" else "contact_estimate"
            contact = _needed(getattr(quantities, name), name, f"contact={self.contact!r}")
            known = contact if known is None else known + contact
        return known

    @staticmethod
    def _elimination(M: FloatArray, nb: int) -> FloatArray:
        """S = M_jb M_bb^{-1}."""
        try:
            S: FloatArray = np.asarray(np.linalg.solve(M[..., :nb, :nb], M[..., :nb, nb:]), dtype=float)
        except np.linalg.LinAlgError:
            raise ValueError("M: the block of the base is singular, expected positive definite") from None
        return np.swapaxes(S, -1, -2)


def balanced_contact(
    bias: ArrayLike, jacobian: ArrayLike, standing: ArrayLike, *, base: int = 6
) -> FloatArray:
    """Contact torques of the least contact forces that carry the base at rest.

    J_b' F = c_b for the feet that stand, F of least norm; returned is k = J' F. Needs no force sensor; wrong by what
    the base accelerates, and by internal forces between the feet, which the base does not feel.

    Parameters
    ----------
    bias : (..., n_v) array
        c, base rows first.
    jacobian : (..., feet, 3, n_v) array
        Of the contact points.
    standing : (..., feet) array
        In [0, 1]: which feet carry; a weight of 0.5 lets a foot carry less.
    base : int
        Degrees of freedom of the base.

    Returns
    -------
    (..., n_v) array

    Raises
    ------
    ValueError
        For shapes that do not belong together, or weights outside [0, 1].

    Examples
    --------
    One foot below a mass on a vertical slide carries it:

    >>> balanced_contact([9.81, 0.0], [[[0.0, 0.0], [0.0, 0.0], [1.0, 0.5]]], [1.0], base=1).round(3).tolist()
    [9.81, 4.905]
    """
    c, J, weight = (np.asarray(part, dtype=float) for part in (bias, jacobian, standing))
    if J.ndim < 3 or c.ndim < 1 or J.shape[-1] != c.shape[-1] or weight.shape[-1:] != J.shape[-3:-2]:
        raise ValueError(
            "expected bias (..., n_v), jacobian (..., feet, 3, n_v) and standing (..., feet), got "
            f"{c.shape}, {J.shape} and {weight.shape}"
        )
    if not np.all((weight >= 0.0) & (weight <= 1.0)):
        raise ValueError("standing: expected weights in [0, 1]")
    J = J * weight[..., None, None]
    rows = J.reshape(*J.shape[:-3], -1, J.shape[-1])  # (..., 3 feet, n_v)
    force: FloatArray = np.matmul(np.linalg.pinv(np.swapaxes(rows[..., :base], -1, -2)), c[..., :base, None])
    torque: FloatArray = np.matmul(np.swapaxes(rows, -1, -2), force)
    return torque[..., 0]


def _needed(value: FloatArray | None, name: str, what: str) -> FloatArray:
    if value is None:
        raise ValueError(f"{what} needs the quantity {name}, which is missing")
    return value


def _positive(inertia: FloatArray, name: str) -> FloatArray:
    """The inertia, if it is positive definite: numbers and diagonals entry by entry, matrices by Cholesky."""
    if inertia.ndim < 2 or inertia.shape[-1] != inertia.shape[-2] or name.startswith("the diagonal"):
        good = np.isfinite(inertia).all() and np.all(inertia > 0.0)
    else:
        try:
            good = np.isfinite(np.linalg.cholesky(inertia)).all()
        except np.linalg.LinAlgError:
            good = False
    if not good:
        raise ValueError(
            f"{name}: expected a positive definite inertia in kg m^2; check units and order of the axes"
        )
    return inertia
