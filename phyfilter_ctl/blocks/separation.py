"""The parts of the residual as a block that runs at its own rate: the filter of :func:`separate`, for C and FMUs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..estimation import ModelScale, Part, Regressor
from ..estimation.separation.changes import Schedule
from ..estimation.separation.identifiability import WEAK
from ..estimation.separation.kalman import started
from ..estimation.separation.separate import fractions
from ..estimation.separation.structure import LEAST_SHARE, Moments, Working, moments, structure_of
from ..filter.matrices import constant_inertia
from ..filter.sampling import Rule
from .changes import Update, Watch
from .functions import BlockFunctions, Variable
from .sampled import SampledBlock, sampled_block

__all__ = ["separation_block"]

# Each step is one straight expression: about 40,000 operations at 24 states, which grow like the third power.
_MOST_STATES = 24


def separation_block(
    parts: Sequence[Part],
    channels: int,
    *,
    dt: float,
    noise: ArrayLike,
    inertia: ArrayLike | None = None,
    fraction: float | Mapping[str, float] = 0.5,
    g: Rule = "hold",
    watch: str | None = None,
    false_alarms: float = 1.0,
    within: float = 0.3,
    restart: bool = True,
    name: str = "separation",
) -> SampledBlock:
    """What the residual is made of, as it comes: the filter of :func:`separate` with ``causal=True`` as a block.

    At its instants it does a step of that filter; at the first it remembers what it reads, and f_hat is f_theta.

    Parameters
    ----------
    parts : sequence of Payload, AddedInertia, Regressor, ModelScale, SteadyForce, ColouredForce, SensorBias
        As for :func:`separate`. Of the ``values`` of a Regressor only the shape (N, n_x) or (N, n_x, p) matters: they
        are inputs here.
    channels : int
        Number n_x of channels of x.
    dt : float
        Seconds between instants.
    noise : float or (n_x,) array_like
        Deviation of the white noise of M x.
    inertia : float, (n_x,) or (n_x, n_x) array_like, optional
        Constant M; None means I.
    fraction : float, or dict of str to float
        From which share of its prior deviation on a scalar is identified, as for :func:`separate`.
    g : {"hold", "average"}
        Between instants. With "hold" the block takes the g that acts from this sample on, and a command may depend on
        the outputs without an algebraic loop.
    watch : str, optional
        Part whose sudden changes are looked for as :meth:`Separation.changes <phyfilter_ctl.Separation.changes>` does.
    false_alarms, within : float
        Of these tests, as there.
    restart : bool
        Whether the filter counts a change that it alarms of, at once; else it follows it slowly.
    name : str
        Name of the block.

    Returns
    -------
    SampledBlock
        Inputs x[i], g[i], f_theta[i], and of each Regressor name[i], or name[i,j] of p columns. Outputs f_hat[i],
        f_theta and all parts; then of each scalar the estimate under its label, its standard deviation sd_label, and
        known_label: 1 where the data identify it, else 0. An estimate that is not identified is the prior mean. With
        ``watch``, alarm, 1 at the instants at which a change is noticed; statistic, the largest test that ends there;
        age, how long ago that change began most likely, s; and jump_label of each scalar of the part, its size.

    Notes
    -----
    A change that began at the start of a test leaves D times its size in the state's error now, D the trace that the
    test follows. With ``restart`` the state moves by D nu and its covariance grows by D C D', where nu and C are mean
    and covariance of the size, given its signature in the innovations and the part's own prior (A. S. Willsky, H. L.
    Jones, see :meth:`Separation.changes <phyfilter_ctl.Separation.changes>`): the filter that had known when, but not
    how much.

    Raises
    ------
    TypeError
        If an argument is of another kind.
    ValueError
        As :func:`separate` and :meth:`Separation.changes <phyfilter_ctl.Separation.changes>`, or if x and the
        scalars are more than 24 states.

    Examples
    --------
    >>> from phyfilter_ctl.estimation import ColouredForce, Payload
    >>> parts = [Payload(1.0, gravity=[9.81]), ColouredForce(1.0, bandwidth=5.0)]
    >>> block = separation_block(parts, 1, dt=0.01, noise=0.03, inertia=3.0)
    >>> block.output_labels[:3], block.output_labels[-2:]
    (['f_hat[0]', 'payload', 'wind'], ['known_payload', 'known_wind'])
    >>> separation_block(parts, 1, dt=0.01, noise=0.03, inertia=3.0, watch="payload").output_labels[-4:]
    ['alarm', 'statistic', 'age', 'jump_payload']
    """
    n_x = _signals.count("channels", channels)
    h = _signals.duration("dt", dt)
    structure = structure_of(parts, n_x)
    if n_x + len(structure.labels) > _MOST_STATES:
        raise ValueError(
            f"parts: expected at most {_MOST_STATES} states, got {n_x} of x and {len(structure.labels)} scalars; "
            "leave parts out"
        )
    if g not in ("hold", "average"):
        raise ValueError(f"g: expected 'hold' or 'average', got {g!r}")
    given = np.asarray(noise, dtype=float)
    deviation = _signals.array("noise", np.full(n_x, float(given)) if given.ndim == 0 else given, (n_x,))
    if np.any(deviation <= 0.0):
        raise ValueError(f"noise: expected deviations above 0, got {deviation}")
    M = constant_inertia(inertia, n_x)
    tests = None
    if watch is not None:
        names = [part.name for part in parts]
        if watch not in names:
            raise ValueError(f"watch: expected one of {', '.join(names)}, got {watch!r}")
        watched = np.flatnonzero(structure.part == names.index(watch)).tolist()
        schedule = Schedule.of(h, len(watched), false_alarms=false_alarms, within=within)
        tests = Watch(schedule, watched, n_x, n_x + len(structure.labels), restart)
    working = Working.of(structure, structure.rho(M))
    filter = _Filter(working, moments(structure.rate, structure.density, h), h, M, deviation)
    return sampled_block(_functions(parts, filter, fractions(structure, fraction), g, tests), dt=h, name=name)


@dataclass(frozen=True, eq=False)
class _Filter:
    """A step of the filter in CasADi's symbols, which takes the samples of x one channel after the other.

    Attributes
    ----------
    working : Working
    step : Moments
    h : float
    M : (n_x, n_x) array
    noise : (n_x,) array
        Of M x.
    """

    working: Working
    step: Moments
    h: float
    M: FloatArray
    noise: FloatArray

    @property
    def R(self) -> FloatArray:
        """Covariance of the noise of x."""
        into_x = np.asarray(np.linalg.inv(self.M), dtype=float)
        return into_x @ np.diag(self.noise**2) @ into_x.T

    def share(self, c: ca.SX) -> ca.SX:
        """M over M + theta J."""
        theta = self.working.structure.theta
        return ca.SX(1) if theta is None else ca.fmax(1.0 + c[theta], LEAST_SHARE)

    def predicted(
        self, x: ca.SX, c: ca.SX, P: ca.SX, impulse: ca.SX, load: ca.SX
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        """State (x, c) and its covariance a step later, and the transition."""
        step, theta, share = self.step, self.working.structure.theta, self.share(c)
        into_x = _constant(np.asarray(np.linalg.inv(self.M), dtype=float))
        push = ca.mtimes(into_x, load)
        to_x, stay = ca.mtimes(push, _diagonal(step.area)), _diagonal(step.stay)
        n_x, p = push.shape
        F = ca.vertcat(ca.horzcat(ca.SX.eye(n_x), to_x), ca.horzcat(ca.SX(p, n_x), stay))
        square = [share**2] * p
        if theta is not None:
            square[theta] = self.working.rho**2 * share**4
        scale = ca.diag(ca.vertcat(*square))
        both = ca.mtimes([push, scale, _diagonal(step.area_end)])
        Q = ca.vertcat(
            ca.horzcat(ca.mtimes([push, scale, _diagonal(step.area_area), push.T]), both),
            ca.horzcat(both.T, ca.mtimes(scale, _diagonal(step.end))),
        )
        mean = ca.vertcat(x + ca.mtimes(into_x, impulse) + ca.mtimes(to_x, c), ca.mtimes(stay, c))
        return mean, ca.mtimes([F, P, F.T]) + Q, F

    def corrected(self, z: ca.SX, P: ca.SX, measured: ca.SX) -> tuple[ca.SX, ca.SX, list[Update]]:
        """After the measurement of x, its noise made white of variance 1 first; and what each channel of it did."""
        white = np.asarray(np.linalg.inv(np.linalg.cholesky(self.R)), dtype=float)
        H = _constant(white @ np.hstack([np.eye(len(white)), self.working.structure.measured]))
        y = ca.mtimes(_constant(white), measured)
        done = []
        for j in range(len(white)):
            cross = ca.mtimes(P, H[j, :].T)
            s = 1.0 + ca.mtimes(H[j, :], cross)
            done.append(Update(H[j, :], cross, s, y[j] - ca.mtimes(H[j, :], z)))
            z = z + cross * (done[-1].innovation / s)
            P = ca.triu2symm(ca.triu(P - ca.mtimes(cross, cross.T) / s))
        return z, P, done

    def left(self, P: ca.SX, elapsed: ca.SX, jumps: ca.SX) -> ca.SX:
        """Variance (p,) left of each scalar with weak priors, over its prior; see ``with_weak_priors``.

        Each of the ``jumps`` (p,) that were counted has widened the prior by itself.
        """
        structure, sd = self.working.structure, self.working.sd
        units = ca.DM(1.0 / sd)
        scaled = P * ca.mtimes(units, units.T)
        prior = 1.0 + ca.DM(structure.parameter * structure.density / structure.sd**2) * elapsed + jumps
        own = np.flatnonzero(structure.parameter).tolist()
        if not own:
            return ca.diag(scaled) / prior
        D, LT, order = ca.ldl(ca.densify(ca.diag(prior[own] / (1.0 - WEAK)) - scaled[own, own]), False)
        lost = ca.ldl_solve(scaled[own, :], D, LT, order)
        return (ca.diag(scaled) + ca.sum1(scaled[own, :] * lost).T) / prior

    def physical(self, c: ca.SX, P: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Scalars and their variances, as :meth:`Working.physical` has them."""
        theta, share, variance = self.working.structure.theta, self.share(c), ca.diag(P)
        if theta is None:
            return c, variance
        by_eta = -c / share
        turned = (variance + 2.0 * by_eta * P[:, theta] + by_eta**2 * P[theta, theta]) / share**2
        found = c / share
        found[theta] = (1.0 / share - 1.0) / self.working.rho
        turned[theta] = P[theta, theta] / (self.working.rho * share**2) ** 2
        return found, turned

    def moved(self, c: ca.SX, own: list[int]) -> ca.SX:
        """What a jump (p,) of the physical scalars does to the state (n_x + all, p), at the working ones."""
        n_x, theta = self.working.structure.n_x, self.working.structure.theta
        D = ca.SX.zeros(n_x + c.shape[0], len(own))
        share = self.share(c)
        for j, i in enumerate(own):
            D[n_x + i, j] = share
            if i == theta:
                D[n_x:, j] = -self.working.rho * share * c
                D[n_x + i, j] = -self.working.rho * share**2
        return D


def _functions(
    parts: Sequence[Part], filter: _Filter, fraction: FloatArray, g_rule: Rule, tests: Watch | None
) -> BlockFunctions:
    """The law of the block."""
    working, structure = filter.working, filter.working.structure
    n_x, labels = structure.n_x, structure.labels
    n = n_x + len(labels)
    signals = {key: ca.SX.sym(key, n_x) for key in ("x", "g", "f_theta")}
    phi = {
        i: ca.SX.sym(part.name, n_x, int(np.sum(structure.part == i)))
        for i, part in enumerate(parts)
        if isinstance(part, Regressor)
    }
    kept = {"g": signals["g"], "f_theta": signals["f_theta"]} | {parts[i].name: phi[i] for i in phi}
    first = _first(filter, signals["x"]) | ({} if tests is None else tests.first())
    before = {key: ca.SX.sym(f"{key}_before", *symbol.shape) for key, symbol in (first | kept).items()}
    g_end = before["g"] if g_rule == "hold" else signals["g"]
    known = 0.5 * (before["g"] + g_end + before["f_theta"] + signals["f_theta"])
    mean, end = _loads(parts, working, signals, phi, before, known, g_end + signals["f_theta"])
    wide = ca.triu2symm(ca.SX(ca.Sparsity.upper(n), before["P"]))
    z, P, F = filter.predicted(before["x"], before["c"], wide, filter.h * known, mean)
    z, P, done = filter.corrected(z, P, signals["x"])
    now = {"started": ca.SX(1), "elapsed": before["elapsed"] + filter.h}
    found: dict[str, ca.SX] = {}
    if tests is not None:
        prior = structure.sd[tests.own] ** 2
        z, P, seen, found = tests.step(before, filter.moved(before["c"], tests.own), F, done, z, P, prior)
        now, found["age"] = now | seen, filter.h * found["age"]
    now |= {"x": z[:n_x], "c": z[n_x:], "P": _upper(P)}
    going = before["started"]
    following = {key: ca.if_else(going, now[key], first[key]) for key in first} | kept
    of_c = ca.triu2symm(ca.SX(ca.Sparsity.upper(n), following["P"]))[n_x:, n_x:]
    jumps = ca.SX(len(labels), 1)
    if tests is not None:
        jumps[tests.own] = following["jumps"]
    identified = filter.left(of_c, following["elapsed"], jumps) <= ca.DM(fraction**2)
    estimate, variance = filter.physical(following["c"], of_c)
    results = [
        signals["f_theta"] + ca.if_else(going, ca.mtimes(end, following["c"]), 0.0),
        ca.if_else(identified, estimate, ca.DM(structure.mean)),
        ca.sqrt(ca.fmax(variance, 0.0)),
        identified,
        *(ca.if_else(going, value, 0.0) for value in found.values()),
    ]
    arguments = [
        ca.SX.sym("t"),
        _column(before),
        ca.vertcat(*signals.values(), *(ca.vec(each.T) for each in phi.values())),
        ca.SX(0, 1),
    ]
    return BlockFunctions(
        _named(before),
        (
            *(replace(v, optional=v.name.startswith("f_theta[")) for v in _named(signals)),
            *_named({parts[i].name: each for i, each in phi.items()}),
        ),
        tuple(
            Variable(label)
            for label in (
                *(f"f_hat[{i}]" for i in range(n_x)),
                *labels,
                *(f"sd_{label}" for label in labels),
                *(f"known_{label}" for label in labels),
                *([] if tests is None else ["alarm", "statistic", "age"]),
                *([] if tests is None else [f"jump_{labels[i]}" for i in tests.own]),
            )
        ),
        (),
        ca.Function("dynamics", arguments, [ca.densify(_column(following))]),
        ca.Function("output", arguments, [ca.densify(ca.vertcat(*results))]),
    )


def _first(filter: _Filter, x: ca.SX) -> dict[str, ca.SX]:
    """State after the first sample."""
    n_x = filter.working.structure.n_x
    start = started(filter.working, np.zeros(n_x), filter.R)
    return {
        "started": ca.SX(1),
        "elapsed": ca.SX(0),
        "x": x + ca.DM(start.mean[:n_x]),
        "c": ca.SX(ca.DM(start.mean[n_x:])),
        "P": _upper(ca.SX(ca.DM(np.array(start.covariance)))),
    }


def _loads(
    parts: Sequence[Part],
    working: Working,
    signals: Mapping[str, ca.SX],
    phi: Mapping[int, ca.SX],
    before: Mapping[str, ca.SX],
    known: ca.SX,
    known_end: ca.SX,
) -> tuple[ca.SX, ca.SX]:
    """L over the step, its mean, and at its end; g + f_theta likewise are ``known`` and ``known_end``."""
    structure, mean, end = working.structure, [], []
    for i, part in enumerate(parts):
        own = structure.part == i
        if structure.theta is not None and own[structure.theta]:
            weight = ca.DM(structure.weight / working.rho)
            mean.append(known - weight)
            end.append(known_end - weight)
        elif isinstance(part, ModelScale | Regressor):
            first, last = (
                (before[part.name], phi[i])
                if isinstance(part, Regressor)
                else (before["f_theta"], signals["f_theta"])
            )
            hold = part.between == "hold"
            mean.append(first if hold else 0.5 * (first + last))
            end.append(first if hold else last)
        else:
            mean.append(_constant(structure.load[:, own]))
            end.append(mean[-1])
    return ca.horzcat(*mean), ca.horzcat(*end)


def _constant(values: FloatArray) -> ca.SX:
    """Zeros left out."""
    return ca.SX(ca.sparsify(ca.DM(values)))


def _diagonal(values: FloatArray) -> ca.SX:
    return ca.SX(ca.sparsify(ca.diag(ca.DM(values))))


def _named(symbols: Mapping[str, ca.SX]) -> tuple[Variable, ...]:
    """The scalars, row by row; matrices of several columns by row and column."""
    found = []
    for key, symbol in symbols.items():
        rows, columns = symbol.shape
        if key in ("started", "elapsed", "phase", "quiet", "jumps"):
            found.append(key)
        elif columns == 1:
            found += [f"{key}[{i}]" for i in range(rows)]
        else:
            found += [f"{key}[{i},{j}]" for i in range(rows) for j in range(columns)]
    return tuple(Variable(label) for label in found)


def _upper(P: ca.SX) -> ca.SX:
    """The upper triangle, column by column."""
    return ca.vertcat(*[P[i, j] for j in range(P.shape[1]) for i in range(j + 1)])


def _column(parts: Mapping[str, ca.SX]) -> ca.SX:
    return ca.vertcat(*[ca.vec(part.T) for part in parts.values()])
