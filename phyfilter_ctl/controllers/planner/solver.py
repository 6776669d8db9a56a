"""Solvers of the planner's quadratic programme, behind CasADi's conic interface."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from ..._sections import FloatArray
from .problem import QuadraticProgram

__all__ = ["Answer", "ConicSolver", "SolverName"]

SolverName = Literal["daqp", "qpoases", "piqp", "osqp"]

# Silent, with tolerances below what the planner accepts. The iteration limits bound the time of a solve.
_OPTIONS: dict[str, dict[str, Any]] = {
    "daqp": {"daqp": {"primal_tol": 1e-9, "iter_limit": 2000}},
    "qpoases": {"printLevel": "none", "nWSR": 2000},
    "piqp": {"piqp": {"eps_abs": 1e-9, "eps_rel": 1e-10, "max_iter": 200}},
    "osqp": {
        "osqp": {"verbose": False, "eps_abs": 1e-7, "eps_rel": 1e-7, "polish": False, "max_iter": 10000}
    },
}

# DAQP's exit flags, which CasADi passes on as numbers.
_DAQP_STATUS = {
    "-1": "infeasible",
    "-2": "cycling",
    "-3": "unbounded",
    "-4": "iteration limit",
    "-5": "not convex",
    "-6": "too many equalities",
}


class Answer(NamedTuple):
    """What a solver returned."""

    x: FloatArray  # (n,), may be no solution and may not be finite
    solved: bool
    status: str  # in the solver's words


class ConicSolver:
    """One solver for programmes whose constraint matrix is ``rows`` for each of six axes.

    It starts cold at every instant, so that equal inputs give equal plans.
    """

    def __init__(self, name: SolverName, rows: FloatArray) -> None:
        A = np.kron(rows, np.eye(6))
        self._A = ca.sparsify(ca.DM(A))
        shapes = {"h": ca.Sparsity.dense(A.shape[1], A.shape[1]), "a": self._A.sparsity()}
        self._solver = ca.conic("planner", name, shapes, {"error_on_fail": False, **_OPTIONS[name]})

    def __call__(self, programme: QuadraticProgram) -> Answer:
        """The answer; a solver that gives up is a status."""
        H, g, lower, upper, bound = programme
        try:
            answer = self._solver(h=H, g=g, a=self._A, lba=lower, uba=upper, lbx=-bound, ubx=bound)
        except RuntimeError as error:
            return Answer(np.full(len(g), np.nan), False, str(error).splitlines()[-1])
        stats = self._solver.stats()
        status = str(stats.get("return_status", ""))
        return Answer(
            np.array(answer["x"]).ravel(), bool(stats["success"]), _DAQP_STATUS.get(status, status.lower())
        )
