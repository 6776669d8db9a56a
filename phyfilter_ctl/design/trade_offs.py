"""What is gained for what it costs: a design for each of several values, and the errors of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..analysis.bounds import ErrorBound
from ..analysis.variance import Variance
from ..results import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["TradeOff", "trade_off"]

_BOUND, _DEVIATION = "bound", "standard deviation"
_ERROR = "Error from the {} [unit of f]"


@dataclass(frozen=True, eq=False, repr=False)
class TradeOff(Result):
    """Designs over a value, and what each costs; made by :func:`trade_off`.

    Attributes
    ----------
    values : (m,) array
    results : tuple
        What the design gave for each.
    costs : dict of str to (m,) array
        Errors of each; nan where there is none. ``residual`` and ``noise``: what the residual and the noise of x leave
        of it, the other parts of a bound with the residual's.
    label : str
        In which sense they are errors.
    """

    values: FloatArray
    results: tuple[Any, ...] = field(repr=False)
    costs: dict[str, FloatArray]
    label: str = ""

    @property
    def best(self) -> Any:
        """The result whose sum of costs is least; None where no sum is finite."""
        index = self.best_index
        return None if index is None else self.results[index]

    @property
    def best_index(self) -> int | None:
        """Where the best one stands among the results; None where there is none."""
        total = np.sum(list(self.costs.values()), axis=0)
        return int(np.nanargmin(total)) if np.isfinite(total).any() else None

    def plot(self, *, ax: Axes | None = None) -> ct.ControlPlot:
        """One cost over the values, or the second over the first.

        Parameters
        ----------
        ax : Axes, optional
            Where to draw; None makes a new figure.

        Returns
        -------
        control.ControlPlot

        Raises
        ------
        ValueError
            If there are three costs or more.
        """
        from ..plots.promises import trade_off_plot

        if len(self.costs) > 2:
            raise ValueError(f"costs: expected one or two to plot, got {', '.join(self.costs)}")
        if len(self.costs) == 1:
            ((name, cost),) = self.costs.items()
            names = (
                self.label or "Value",
                f"{name.upper() if name == 'rmse' else name.capitalize()} [unit of f]",
            )
            return trade_off_plot(self.values, cost, None, "", names=names, log=False, ax=ax)
        (across, up), names = self.costs.values(), [_ERROR.format(name) for name in self.costs]
        return trade_off_plot(across, up, self.best_index, self.label, names=(names[0], names[1]), ax=ax)


def trade_off(
    design: Callable[[float], Any],
    values: ArrayLike,
    *,
    cost: Callable[[Any], Any] | None = None,
    label: str | None = None,
) -> TradeOff:
    """What is gained for what it costs: a design for each of several values of what is asked for.

    Parameters
    ----------
    design : callable
        float -> what :func:`~phyfilter_ctl.learn`, :func:`~phyfilter_ctl.design.optimal.least_bound`,
        :func:`~phyfilter_ctl.design.optimal.least_variance` or a function of your own returns.
    values : array_like, shape (m,)
        Margins, limits, speeds: what ``design`` is called with.
    cost : callable, optional
        Of a design: an :class:`~phyfilter_ctl.ErrorBound`, a :class:`~phyfilter_ctl.Variance`, what has an ``rmse``, a
        number or a dict of numbers. None: the design is or has one of them.
    label : str, optional
        What is varied, or in which sense the costs are errors; for the picture.

    Returns
    -------
    TradeOff

    Raises
    ------
    TypeError
        If a design has no cost.
    ValueError
        If there are no values, one is not finite, or designs have costs of different names.

    Examples
    --------
    Error against the modulus margin that a learned filter keeps in its loop:

    >>> from dataclasses import replace
    >>> from phyfilter_ctl import Loop, LoopGoal, Recording, learn
    >>> rng = np.random.default_rng(0)
    >>> f = np.sin(0.02 * np.arange(1000))[:, None]
    >>> x = np.cumsum(0.01 * f, axis=0) + 1e-3 * rng.standard_normal(f.shape)
    >>> log, goal = Recording.from_arrays(x=x, dt=0.01, label=f), LoopGoal(Loop(10.0, 6.0, delay=0.04))
    >>> found = trade_off(lambda m: learn(log, 1, loop=replace(goal, modulus_margin=m)), [0.3, 0.5])
    >>> bool(found.costs["rmse"][0] < found.costs["rmse"][1])
    True

    Worst-case error from the residual against that from the noise, from slow to fast filters of the best shape:

    >>> from phyfilter_ctl import Bounded, error_bound
    >>> from phyfilter_ctl.design.optimal import least_bound
    >>> best = least_bound(2, residual={1: 8.0}, noise=0.01).filter
    >>> bounds = Bounded({1: 8.0}, noise=0.01)
    >>> curve = trade_off(best.faster, np.geomspace(0.1, 10, 5), cost=lambda f: error_bound(f, bounds))
    >>> curve.best == best.faster(1.0), bool((np.diff(curve.costs["noise"]) > 0.0).all())
    (True, True)
    """
    wanted = _signals.array("values", values, ("m",))
    results = tuple(design(float(value)) for value in wanted)
    found = [_costs(result if cost is None else cost(result)) for result in results]
    names = list(found[0][0])
    if other := [costs for costs, _ in found if list(costs) != names]:
        raise ValueError(
            f"design: expected costs of the same names for every value, got {names} and {list(other[0])}"
        )
    costs = {name: np.array([own[name] for own, _ in found]) for name in names}
    return TradeOff(wanted, results, costs, found[0][1] if label is None else label)


def _costs(found: Any) -> tuple[dict[str, float], str]:
    """Of what a design gave, and in which sense."""
    found = getattr(found, "bound", found) if not isinstance(found, ErrorBound) else found
    found = getattr(found, "variance", found)
    if isinstance(found, ErrorBound):
        rest = found.intrinsic + found.inertia + sum(found.implementation.values())
        return {"residual": rest, "noise": found.noise}, _BOUND
    if isinstance(found, Variance):
        return {"residual": found.residual_error**0.5, "noise": found.noise**0.5}, _DEVIATION
    if isinstance(found, Mapping):
        return {str(name): float(value) for name, value in found.items()}, ""
    if hasattr(found, "rmse"):
        return {"rmse": float(found.rmse)}, ""
    try:
        return {"cost": float(found)}, ""
    except (TypeError, ValueError):
        raise TypeError(
            "design: expected what has an error (a bound, a variance, an rmse, a number or a dict of numbers), got "
            f"{type(found).__name__}; give cost=, a function of it"
        ) from None
