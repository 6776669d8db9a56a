"""F = N/D by its coefficients and its poles, and what follows from them alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .. import _sections, _signals
from .._sections import ComplexArray, FloatArray
from . import conversion
from .lti import LinearForm, Roots
from .recursion import Chain

if TYPE_CHECKING:
    import sympy

# Two coefficients that agree to this count as equal when the type of 1 - F is read off: they come out of
# products of n poles, each rounded.
_SAME_COEFFICIENT = 1e-12
# A leading coefficient of N below this share of the largest is none: its zero is beyond what a double can hold.
_NO_COEFFICIENT = 1e-300


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Rational(LinearForm):
    """F = N/D with its poles: what :class:`PhyFilter` knows of itself; see there."""

    a: FloatArray
    b: FloatArray
    poles: Roots  # pyright: ignore[reportIncompatibleMethodOverride]  # the array answers python-control's poles()

    def __init__(self, a: ArrayLike, b: ArrayLike | None = None, *, poles: ArrayLike | None = None) -> None:
        a = _coefficients("a", a)
        if b is None:
            b = np.zeros_like(a)
            b[0] = a[0]
        else:
            b = _coefficients("b", b)
            if b.shape != a.shape:
                raise ValueError(
                    f"b has {len(b)} coefficients but a has {len(a)}: expected b_0 ... b_{len(a) - 1}, as many as "
                    "in a; pad with zeros"
                )
        roots = _sections.found_poles(a) if poles is None else _given_poles(poles, len(a))
        worst = roots[np.argmax(roots.real)]
        if not worst.real < 0.0:
            raise ValueError(
                f"D is not Hurwitz: pole {worst:.6g} rad/s has real part {worst.real:.6g}, expected < 0; "
                "the filter would not forget its start"
            )
        if not np.all(a > 0.0):
            k = int(np.argmin(a))
            raise ValueError(
                f"D is not Hurwitz: a_{k} = {a[k]:.6g}, expected > 0: with every pole in the left half plane all "
                "coefficients are positive"
            )
        if poles is not None:
            a, b = _sections.agreeing(roots, a, b)
        with np.errstate(over="ignore"):
            if not np.all(np.isfinite(b / a)):
                raise ValueError(f"b: b_i / a_i leaves the range of double precision for b = {b.tolist()}")
        for name, value in (("a", a), ("b", b), ("poles", Roots(roots))):
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @classmethod
    def from_poles(cls, poles: ArrayLike, b: ArrayLike | None = None) -> Self:
        """Return the filter with these poles, which it keeps exactly.

        Parameters
        ----------
        poles : array_like, shape (n,)
            Roots of D in rad/s; complex ones in conjugate pairs.
        b : array_like, shape (n,), optional
            Ascending coefficients of N; None for the low-pass form.

        Raises
        ------
        ValueError
            As for the class; and if a complex pole lacks its conjugate.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> PhyFilter.from_poles([-3.0 + 4.0j, -3.0 - 4.0j]).a.tolist()
        [25.0, 6.0]
        """
        roots = _given_poles(poles)
        a = _sections.polynomial_from_roots(roots)
        # Below the normal numbers digits are lost, and at 0 the pole is.
        if np.all(roots.real < 0.0) and not (np.all(np.isfinite(a)) and np.all(a >= np.finfo(float).tiny)):
            raise ValueError(
                f"poles: their product leaves the range of double precision, a = {a.tolist()}; choose a unit of time "
                "in which they are about 1"
            )
        return cls(a, b, poles=roots)

    @classmethod
    def from_tf(cls, system: Any) -> Self:
        """Return the filter that another library holds, its coefficients descending as they are there.

        Parameters
        ----------
        system : control.LTI, scipy.signal.lti, tuple or (sections, 6) array
            A continuous system with one input and one output; scipy's ``(b, a)`` or ``(z, p, k)``, or its ``sos``, of
            an analog filter. Poles given as such (z, p, k; sos) are kept exactly.

        Raises
        ------
        TypeError
            If it is none of these.
        ValueError
            If it is discrete, has several inputs or outputs, is not strictly proper, is not Hurwitz, or its denominator
            begins with a zero.

        Examples
        --------
        >>> import control as ct, scipy.signal
        >>> from phyfilter_ctl import PhyFilter
        >>> PhyFilter.from_tf(ct.tf([30.0, 400.0], [1.0, 40.0, 400.0]))
        PhyFilter(a=[400.0, 40.0], b=[400.0, 30.0])
        >>> PhyFilter.from_tf(scipy.signal.butter(2, 20.0, analog=True)).a.round(3).tolist()
        [400.0, 28.284]
        """
        b, known, poles = conversion.rational(system)
        a = _sections.polynomial_from_roots(_sections.given_poles(known)) if poles else known
        # Products of poles round differently: what is meant as the low-pass form stays it.
        if not np.any(b[1:]) and abs(b[0] - a[0]) <= _SAME_COEFFICIENT * abs(a[0]):
            b = None
        return cls.from_poles(known, b) if poles else cls(known, b)

    @property
    def order(self) -> int:
        """Order n of D."""
        return len(self.a)

    @property
    def is_lowpass(self) -> bool:
        """Whether N = a_0, the low-pass form of the paper's Eq. (3)."""
        return bool(self.b[0] == self.a[0] and not np.any(self.b[1:]))

    @cached_property
    def zeros(self) -> Roots:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Zeros of F (roots of N), shape (m,) with m < n."""
        size = np.abs(self.b)
        degree = int(np.max(np.flatnonzero(size > _NO_COEFFICIENT * size.max()), initial=0))
        if degree == 0:
            return Roots(np.zeros(0, dtype=np.complex128))
        return Roots(np.roots(self.b[degree::-1]).astype(np.complex128))

    @cached_property
    def error_numerator(self) -> FloatArray:
        """Ascending coefficients c_k of D - N, shape (n + 1,): c_k = a_k - b_k, c_n = 1.

        Where a_k and b_k agree to rounding c_k is exactly zero, so 1 - F has its zeros at s = 0 exactly.
        """
        difference = self.a - self.b
        difference[np.abs(difference) <= _SAME_COEFFICIENT * np.abs(self.a)] = 0.0
        return np.append(difference, 1.0)

    @cached_property
    def type(self) -> int:
        """Number k of zeros of 1 - F at s = 0: residuals that are polynomials in t of degree k - 1 are followed
        with no steady error."""
        return int(np.argmax(self.error_numerator != 0.0))

    @property
    def dc_gain(self) -> float:
        """F(0) = b_0 / a_0."""
        return float(self.b[0] / self.a[0])

    @cached_property
    def sections(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Chain of first- and second-order sections of unit gain, the fastest pole first: (A, equilibrium, C).

        Returns
        -------
        A : (n, n) array
            w' = A (w - equilibrium u).
        equilibrium : (n,) array
            State for a constant unit input; the input vector is -A @ equilibrium.
        C : (n,) array
            F u = C w.
        """
        poles = self.poles()
        A, equilibrium = _sections.chain(poles)
        return A, equilibrium, _sections.chain_output(poles, self.a, self.b)

    @property
    def chain(self) -> Chain:
        """The poles with :attr:`sections`."""
        return Chain(self.poles(), *self.sections)

    @property
    def transfer_function(self) -> ct.TransferFunction:
        """F(s) as a python-control transfer function."""
        return ct.TransferFunction(_trimmed(self.b), [1.0, *self.a[::-1]])

    @property
    def error_transfer_function(self) -> ct.TransferFunction:
        """1 - F(s), from the residual gamma = f - f_theta to the error f - f_hat."""
        return ct.TransferFunction(self.error_numerator[::-1], [1.0, *self.a[::-1]])

    def __call__(self, s: ArrayLike, squeeze: bool | None = None, warn_infinite: bool = True) -> ComplexArray:
        """F at complex frequencies s (rad/s), same shape; from the poles, so right on repeated ones too.

        Parameters
        ----------
        s : array_like
            Complex frequencies.
        squeeze : bool, optional
            As python-control has it: False gives shape (1, 1, ...), True drops axes of length 1.
        warn_infinite : bool
            False: no warning where s is a pole.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> abs(PhyFilter([20.0])(20j)).round(6).item()
        0.707107
        """
        with np.errstate() if warn_infinite else np.errstate(divide="ignore", invalid="ignore"):
            value = self._over_denominator(self.b, s)
        if squeeze is None:
            return value
        return np.squeeze(value) if squeeze else value[None, None, ...]

    def error(self, s: ArrayLike) -> ComplexArray:
        """1 - F at complex frequencies s (rad/s), same shape, without cancellation near s = 0.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> abs(PhyFilter([20.0]).error(2e-9j)).round(20).item()
        1e-10
        """
        return self._over_denominator(self.error_numerator, s)

    def _over_denominator(self, numerator: FloatArray, s: ArrayLike) -> ComplexArray:
        s = np.asarray(s, dtype=np.complex128)
        with np.errstate(over="ignore", invalid="ignore"):
            value = np.asarray(np.polynomial.polynomial.polyval(s, numerator), dtype=np.complex128)
        beyond = ~np.isfinite(value) & np.isfinite(s)
        value = np.where(beyond, 0.0, value)
        for pole in self.poles():  # one at a time: no intermediate overflows before F itself would
            value = np.divide(value, s - pole)
        if np.any(beyond):  # so far out that only the highest powers count
            degree = int(np.max(np.flatnonzero(numerator), initial=0))
            far = numerator[degree] * np.where(beyond, s, 1.0) ** (degree - float(self.order))
            value = np.where(beyond, far, value)
        return value

    def faster(self, factor: float) -> Self:
        """The same filter with time running faster: F(s / factor), poles and zeros times the factor.

        Raises
        ------
        ValueError
            Unless the factor is positive.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> PhyFilter([20.0]).faster(2.0).a.tolist()
        [40.0]
        """
        if not (np.isfinite(factor) and factor > 0.0):
            raise ValueError(f"factor: expected a positive number, got {factor}")
        powers = factor ** np.arange(self.order, 0, -1.0)
        return type(self)(self.a * powers, self.b * powers, poles=self.poles * factor)

    def formula(self) -> sympy.Expr:
        """F(s) as a SymPy expression in ``s``, coefficients at six digits.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> PhyFilter([400.0, 40.0]).formula()
        400/(s**2 + 40*s + 400)
        """
        import sympy  # half a second that only a formula is worth

        s = sympy.Symbol("s")
        numerator = sum((_number(c) * s**i for i, c in enumerate(self.b) if c), start=sympy.Integer(0))
        denominator = sum((_number(c) * s**i for i, c in enumerate(self.a)), start=s**self.order)
        return numerator / denominator

    def _repr_latex_(self) -> str:  # pyright: ignore[reportIncompatibleMethodOverride]
        import sympy

        return f"$\\displaystyle F(s) = {sympy.latex(self.formula())}$"

    def describe(self) -> str:
        """Formula, poles, type and bandwidth in words, for reading.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> print(PhyFilter([400.0, 40.0]).describe())
        F(s) = 400/(s**2 + 40*s + 400)
        order       2, low-pass form
        poles       -20, -20 rad/s
        zeros of F  none
        type        1: follows a constant residual with no steady error
        F(0)        1
        """
        form = "low-pass form" if self.is_lowpass else "general form"
        followed = {
            0: "leaves a share of a constant residual",
            1: "follows a constant residual with no steady error",
        }
        meaning = followed.get(self.type, f"follows residuals t^0 ... t^{self.type - 1} with no steady error")
        lines = {
            "order": f"{self.order}, {form}",
            "poles": ", ".join(_complex_text(p) for p in self.poles) + " rad/s",
            "zeros of F": (", ".join(_complex_text(z) for z in self.zeros) + " rad/s")
            if len(self.zeros)
            else "none",
            "type": f"{self.type}: {meaning}",
            "F(0)": f"{self.dc_gain:.6g}",
        }
        return "\n".join([f"F(s) = {self.formula()}", *(f"{name:<12}{text}" for name, text in lines.items())])

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Rational):
            return NotImplemented
        return np.array_equal(self.a, other.a) and np.array_equal(self.b, other.b)

    def __hash__(self) -> int:
        return hash((self.a.tobytes(), self.b.tobytes()))

    def __setstate__(self, state: dict[str, object]) -> None:
        # numpy forgets on a copy or in a pickle that an array is read-only.
        for name, value in state.items():
            if name in ("a", "b", "poles") and isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        numerator = "" if self.is_lowpass else f", b={self.b.tolist()}"
        return f"{type(self).__name__}(a={self.a.tolist()}{numerator})"


def _given_poles(poles: ArrayLike, n: int | None = None) -> ComplexArray:
    return _sections.given_poles(_signals.real("poles", poles, np.complex128), n)


def _coefficients(name: str, values: ArrayLike) -> FloatArray:
    """A finite, non-empty vector of its own."""
    vector = _signals.real(name, values) + 0.0  # no -0.0: it would equal 0.0 and hash apart
    if vector.ndim != 1 or len(vector) == 0:
        raise ValueError(
            f"{name}: expected the coefficients {name}_0 ... {name}_(n-1) of an order n >= 1 in one dimension, "
            f"got shape {vector.shape}"
        )
    if len(vector) > _sections.HIGHEST_ORDER:
        raise ValueError(
            f"{name}: expected at most {_sections.HIGHEST_ORDER} coefficients, got {len(vector)}: choose a lower "
            "order"
        )
    if not np.all(np.isfinite(vector)):
        raise ValueError(f"{name}: every coefficient must be finite, got {vector.tolist()}")
    return vector


def _trimmed(ascending: FloatArray) -> FloatArray:
    """Descending coefficients without leading zeros."""
    degree = int(np.max(np.nonzero(ascending)[0], initial=0))
    return ascending[degree::-1]


def _number(value: float) -> sympy.Expr:
    import sympy

    short = float(f"{value:.6g}")
    return sympy.Integer(int(short)) if short == int(short) else sympy.Float(short, 6)


def _complex_text(value: complex) -> str:
    if value.imag == 0.0:
        return f"{value.real:.6g}"
    return f"{value.real:.6g}{value.imag:+.6g}j"
