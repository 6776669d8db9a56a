"""A Rosenbrock method for stiff diagrams: linear equations with the exact Jacobian in place of Newton's iteration.

Rodas5P: eight stages, order 5(4), stiffly accurate and L-stable, a polynomial of fourth order inside the step. G.
Steinebach, "Construction of Rosenbrock-Wanner method Rodas5P and numerical benchmarks within the Julia Differential
Equations package", BIT 63, 27 (2023). Its form without products by the Jacobian: Hairer, Wanner, "Solving Ordinary
Differential Equations II", IV.7,

    (I / (gamma h) - J) U_i = f(t + c_i h, x + sum_j a_ij U_j) + sum_j C_ij U_j / h + d_i h df/dt.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import casadi as ca
import numpy as np

from .._sections import FloatArray
from ..diagram import FlatModel
from .pair import Pair, sizes
from .steps import KEPT, SYMBOLS, Results, compose

__all__ = ["rosenbrock"]

_GAMMA = 0.21193756319429014
_A = (
    (),
    (3.0,),
    (2.849394379747939, 0.45842242204463923),
    (-6.954028509809101, 2.489845061869568, -10.358996098473584),
    (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
    (-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946),
)
_C = (
    (),
    (-14.155112264123755,),
    (-17.97296035885952, -2.859693295451294),
    (147.12150275711716, -1.41221402718213, 71.68940251302358),
    (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
    (24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471),
    (30.91273214028599, -3.1208243349937974, 77.79954646070892, 34.28646028294783, -19.097331116725623,
     -28.087943162872662),
    (37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047, -40.06618937091002,
     -54.66780262877968, -9.48861652309627),
)  # fmt: skip
_NODES = (0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1.0, 1.0, 1.0)
_D = (_GAMMA, -0.42387512638858027, -0.3384627126235924, 1.8046452872882734, 2.325825639765069, 0.0, 0.0, 0.0)
_H = (
    (25.948786856663858, -2.5579724845846235, 10.433815404888879, -2.3679251022685204, 0.524948541321073,
     1.1241088310450404, 0.4272876194431874, -0.17202221070155493),
    (-9.91568850695171, -0.9689944594115154, 3.0438037242978453, -24.495224566215796, 20.176138334709044,
     15.98066361424651, -6.789040303419874, -6.710236069923372),
    (11.419903575922262, 2.8879645146136994, 72.92137995996029, 80.12511834622643, -52.072871366152654,
     -59.78993625266729, -0.15582684282751913, 4.883087185713722),
)  # fmt: skip
# Up to so many states the equations are solved by scalar instructions, which run fastest.
_SCALAR = 10


def _combined(weights: tuple[float, ...], stages: list[ca.SX], like: ca.SX) -> ca.SX:
    total = like
    for weight, stage in zip(weights, stages, strict=False):
        total = total + weight * stage
    return total


def _solver(matrix: ca.SX) -> Callable[[ca.SX], ca.SX]:
    """Solutions for one matrix, factorised once."""
    if isinstance(matrix, ca.SX):
        Q, R = ca.qr(ca.densify(matrix))
        return lambda right: ca.solve(R, Q.T @ right)
    inverse = ca.solve(matrix, SYMBOLS[1](ca.DM.eye(matrix.shape[0])), "csparse")
    return lambda right: inverse @ right


def _derivatives(flat: FlatModel, kind: type[ca.SX]) -> ca.Function:
    """(x, t, u, rate of u, p, z) -> slope, its sparse Jacobian, and its derivative by time along the inputs."""
    lengths = sizes(flat)
    x, t, u, rate, p, z, elapsed = (
        kind.sym(f"i{i}", length)
        for i, length in enumerate((lengths[0], 1, lengths[2], lengths[3], lengths[4], lengths[5], 1))
    )
    slope = flat.dynamics(t + elapsed, x, u + elapsed * rate, p, z)
    results = [slope, ca.jacobian(slope, x), ca.densify(ca.jacobian(slope, elapsed))]
    whole = ca.Function("pf_slopes", [x, t, u, rate, p, z, elapsed], results)
    values = whole.call([x, t, u, rate, p, z, kind(0)])
    return ca.Function("pf_slopes", [x, t, u, rate, p, z], values)


@lru_cache(maxsize=KEPT)
def _trial(flat: FlatModel) -> ca.Function:
    """One step: x at its end, its error over the tolerance, the stages, and the slope at its beginning."""
    n_x = len(flat.states)

    def body(*arguments: ca.SX) -> Results:
        x, q, u, rate, p, z, first = arguments
        t, h = q[0], q[1]
        f, J, in_time = _derivatives(flat, type(x)).call([x, t, u, rate, p, z])
        solve = _solver(type(x)(ca.DM.eye(n_x)) / (_GAMMA * h) - J)
        stages: list[ca.SX] = []
        after = x
        for i, (coupling, node, weight) in enumerate(zip(_C, _NODES, _D, strict=True)):
            # The last three stages lie at the end of the step, each on what the one before came to.
            after = _combined(_A[i], stages, x) if i < len(_A) else after + stages[-1]
            value = flat.dynamics(t + node * h, after, u + node * h * rate, p, z) if i else f
            right = _combined(coupling, stages, x * 0.0) / h + value + weight * h * in_time
            stages.append(solve(right))
        change = stages[-1]
        after = after + change
        scale = q[3] + q[2] * ca.fmax(ca.fabs(x), ca.fabs(after))
        return after, ca.norm_2(change / scale) / np.sqrt(n_x), ca.horzcat(*stages), f + 0.0 * first

    kinds = SYMBOLS if n_x <= _SCALAR else SYMBOLS[1:]
    return compose("pf_rodas5p", [*sizes(flat), n_x], body, kinds)


@lru_cache(maxsize=KEPT)
def _interpolant(flat: FlatModel) -> ca.Function:
    """Coefficients of the polynomial in a step: its change, and what the stages add."""
    n_x = len(flat.states)

    def body(*arguments: ca.SX) -> Results:
        *given, after, stages = arguments
        columns = list(ca.horzsplit(ca.reshape(stages, n_x, len(_C))))
        return (ca.horzcat(after - given[0], *(_combined(row, columns, after * 0.0) for row in _H)),)

    return compose("pf_rodas5p_dense", [*sizes(flat), n_x, n_x * len(_C)], body)


def _inside(coefficients: FloatArray, part: FloatArray) -> FloatArray:
    """Change of x at parts of the step, (k, n_x)."""
    change, *more = coefficients
    s = part[:, None]
    return s * (change + (1.0 - s) * (more[0] + s * (more[1] + s * more[2])))


def rosenbrock(flat: FlatModel) -> Pair:
    """The pair for a model."""
    return Pair("stiff", 5, 0.3, (0.9, 0.2, 6.0), _trial(flat), partial(_interpolant, flat), _inside)
