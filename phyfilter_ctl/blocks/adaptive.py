"""The adaptive law of a Chebyshev model as a block that runs at its own rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from ..learned import AdaptiveChebyshev, Chebyshev
from .functions import BlockFunctions, Variable
from .learned import labelled
from .sampled import SampledBlock, sampled_block

__all__ = ["adaptive_block"]

# The q x q equation of each step is solved symbol by symbol: 700 operations at 16, and they grow like q^3.
_MOST_ENTRIES = 16


def adaptive_block(
    law: AdaptiveChebyshev,
    *,
    features: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    name: str = "seer",
) -> SampledBlock:
    """An adaptive Chebyshev model f_theta = Xi Phi(z) varsigma for diagrams, which adapts varsigma as it runs.

    At its instants it does what :meth:`AdaptiveChebyshev.step` does; at the first, what ``start`` does, and f_theta is
    that of the prior.

    Parameters
    ----------
    law : AdaptiveChebyshev
        Its interval ``dt`` is the block's.
    features, outputs : sequence of str, optional
        Labels of the features and of the prediction; None means z[0], z[1] ... and f_theta[0], f_theta[1] ...
    name : str
        Name of the block.

    Returns
    -------
    SampledBlock
        Inputs: the features, the measured x[i] and the known dynamics g[i]. Outputs: f_theta[i], then varsigma[j].
        Parameters ``rate``, ``bandwidth``, ``leakage`` and, for the composite law, ``memory``, all with the law's
        values as defaults; ``rate`` 0 holds varsigma at the prior.

    Raises
    ------
    TypeError
        For something that is not an :class:`AdaptiveChebyshev`.
    ValueError
        For another number of labels than there are features or predictions, or a varsigma of more than 16 entries.

    Notes
    -----
    With ``g="hold"`` the block takes the g that acts from this sample on, so a command may depend on f_theta without an
    algebraic loop.
    The adapted entries solve (I (1 + h leakage) + h gain G) varsigma = right-hand side, symmetric and positive definite
    whatever the data, by LDL' without pivoting.

    ``linearize`` at the start of the block gives the model with its prior; adaptation then counts from the state
    ``started`` = 1 on.

    Examples
    --------
    >>> v, d = np.meshgrid(np.linspace(-3.0, 3.0, 7), np.linspace(0.0, 1.0, 5))
    >>> z = np.column_stack([v.ravel(), d.ravel()])
    >>> model = Chebyshev(2, degree_d=1).fit(z, (-d * v).reshape(-1, 1)).model
    >>> block = adaptive_block(AdaptiveChebyshev(model, 0.01, rate=20.0), features=["v"])
    >>> block.input_labels, block.output_labels
    (['v', 'x[0]', 'g[0]'], ['f_theta[0]', 'varsigma[0]', 'varsigma[1]'])
    """
    if not isinstance(law, AdaptiveChebyshev):
        raise TypeError(f"law: expected an AdaptiveChebyshev, got {type(law).__name__}")
    assert law.model.Xi is not None  # an AdaptiveChebyshev
    assert law.model.bounds is not None
    assert law.prior is not None
    (n_x, _), q = law.model.Xi.shape, len(law.prior)
    if q > _MOST_ENTRIES:
        raise ValueError(
            f"law: expected a varsigma of at most {_MOST_ENTRIES} entries, got {q}; lower degree_d of the model"
        )
    z = labelled("features", "z", features, len(law.model.bounds) - law.model.n_d)
    signals = [Variable(f"{letter}[{i}]") for letter in "xg" for i in range(n_x)]
    f_theta = labelled("outputs", "f_theta", outputs, n_x)
    varsigma = tuple(Variable(f"varsigma[{i}]", float(start)) for i, start in enumerate(law.prior))

    parameters = _parameters(law)
    t, v = ca.SX.sym("t"), ca.SX.sym("v", len(z) + 2 * n_x)
    p = {entry.name: ca.SX.sym(entry.name) for entry in parameters}
    before = _states(law, n_x, q)
    features_now, x, g = ca.vertsplit(v, [0, len(z), len(z) + n_x, len(z) + 2 * n_x])
    Y = _regressor(law.model, features_now, q)
    now = _step(law, before, Y, x, g, p)
    # varsigma, the filtered signals and their means start where they are.
    first = {"started": ca.SX(1), "Y": Y, "x": x, "g": g}
    following = {
        label: ca.if_else(before["started"], now[label], first.get(label, symbol))
        for label, symbol in before.items()
    }
    results = ca.vertcat(ca.mtimes(Y, following["varsigma"]), following["varsigma"])
    arguments = [t, _column(before), v, ca.vertcat(*p.values())]
    functions = BlockFunctions(
        _named(before, np.asarray(law.prior)),
        (*z, *signals),
        (*f_theta, *varsigma),
        parameters,
        ca.Function("dynamics", arguments, [ca.densify(_column(following))]),
        ca.Function("output", arguments, [ca.densify(results)]),
    )
    return sampled_block(functions, dt=law.dt, name=name)


def _parameters(law: AdaptiveChebyshev) -> tuple[Variable, ...]:
    composite = (Variable("memory", law.memory, "s", "time constant of the composite law", 0.0),)
    return (
        Variable("rate", law.rate, "1/s", "speed of the adaptation", 0.0),
        Variable("bandwidth", law.bandwidth, "rad/s", "feedback of the state prediction", 0.0),
        Variable("leakage", law.leakage, "1/s", "pull towards the prior", 0.0),
        *(composite if law.memory > 0.0 else ()),
    )


def _states(law: AdaptiveChebyshev, n_x: int, q: int) -> dict[str, ca.SX]:
    """What AdaptationState carries, as far as the law uses it."""
    shapes = {"started": (1, 1), "varsigma": (q, 1), "residual": (n_x, 1), "regressor": (n_x, q)}
    if law.memory > 0.0:
        shapes |= {"gram": (q, q), "moment": (q, 1)}
    shapes |= {"x": (n_x, 1), "g": (n_x, 1), "Y": (n_x, q)}
    return {label: ca.SX.sym(label, *shape) for label, shape in shapes.items()}


def _named(states: Mapping[str, ca.SX], prior: np.ndarray) -> tuple[Variable, ...]:
    """The scalars of the states, row by row."""
    variables = []
    for label, symbol in states.items():
        rows, columns = symbol.shape
        indices = [
            f"[{i},{j}]" if columns > 1 or label in ("regressor", "gram", "Y") else f"[{i}]"
            for i in range(rows)
            for j in range(columns)
        ]
        starts = prior if label == "varsigma" else np.zeros(rows * columns)
        variables += [
            Variable(label if label == "started" else label + index, float(start))
            for index, start in zip(indices, starts, strict=True)
        ]
    return tuple(variables)


def _column(parts: Mapping[str, ca.SX]) -> ca.SX:
    return ca.vertcat(*[ca.vec(part.T) for part in parts.values()])


def _regressor(model: Chebyshev, z: ca.SX, q: int) -> ca.SX:
    """Xi Phi(z), (n_x, q), as :meth:`Chebyshev.regressor`."""
    assert model.Xi is not None
    assert model.bounds is not None
    bounds = model.bounds[: z.numel()]
    s = (z - ca.DM(bounds.mean(axis=1))) / ca.DM(0.5 * np.diff(bounds)[:, 0])
    s = ca.fmin(ca.fmax(s, -1.0), 1.0) if model.outside == "clip" else s
    phi = ca.SX(1)
    for i in range(z.numel()):
        T = [ca.SX(1), s[i]]
        for _ in range(model.degree - 1):
            T.append(2.0 * s[i] * T[-1] - T[-2])
        phi = ca.kron(phi, ca.vertcat(*T[: model.degree + 1]))
    # The entries of varsigma vary fastest along the columns of Xi.
    return ca.horzcat(*[ca.mtimes(ca.DM(model.Xi[:, j::q]), phi) for j in range(q)])


def _step(
    law: AdaptiveChebyshev, before: Mapping[str, ca.SX], Y: ca.SX, x: ca.SX, g: ca.SX, p: Mapping[str, ca.SX]
) -> dict[str, ca.SX]:
    """The recursion of :class:`AdaptiveChebyshev`."""
    h, c = law.dt, -ca.expm1(-p["bandwidth"] * law.dt)
    known = before["g"] if law.g == "hold" else 0.5 * (before["g"] + g)
    W = before["regressor"] + c * (0.5 * (before["Y"] + Y) - before["regressor"])
    r = before["residual"] + c * ((x - before["x"]) / h - known - before["residual"])
    G, m = ca.mtimes(W.T, W), ca.mtimes(W.T, r)
    now = {"started": ca.SX(1), "residual": r, "regressor": W, "x": x, "g": g, "Y": Y}
    if law.memory > 0.0:
        fading = -ca.expm1(-h / p["memory"])
        now["gram"] = before["gram"] + fading * (G - before["gram"])
        now["moment"] = before["moment"] + fading * (m - before["moment"])
        G, m = G + now["gram"], m + now["moment"]
    gain = h * p["rate"] * (law.gain / law.rate)
    pull = h * p["leakage"]
    drive = before["varsigma"] + pull * ca.DM(np.asarray(law.prior))
    now["varsigma"] = _solved(drive, gain * G, gain * m, pull, fixed=0 if law.adapt_constant else 1)
    return now


def _solved(drive: ca.SX, G: ca.SX, m: ca.SX, pull: ca.SX, *, fixed: int) -> ca.SX:
    """w of (1 + pull) w + G w = drive + m; the first ``fixed`` entries are not adapted: (1 + pull) w = drive."""
    held = drive[:fixed] / (1.0 + pull)
    if fixed == drive.numel():
        return held
    A = G[fixed:, fixed:] + (1.0 + pull) * ca.SX.eye(drive.numel() - fixed)
    right = (drive + m)[fixed:] - ca.mtimes(G[fixed:, :fixed], held)
    D, LT, order = ca.ldl(ca.densify(A), False)
    return ca.vertcat(held, ca.ldl_solve(right, D, LT, order))
