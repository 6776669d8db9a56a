"""Continuous blocks with events: something reaches a value, and the states jump or the equations change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NoReturn, TypeAlias

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .function_block import FunctionBlock, copied, share

__all__ = ["BlockFunction", "Direction", "Event", "HybridBlock", "event", "hybrid"]

# f(t, x, u, params), as python-control calls it.
BlockFunction: TypeAlias = Callable[[float, Any, Any, Mapping[str, Any]], object]
Direction: TypeAlias = Literal["rising", "falling", "either"]
_DIRECTIONS: dict[str, int] = {"rising": 1, "falling": -1, "either": 0}


@dataclass(frozen=True)
class Event:
    """An event of a block; made by :func:`event`.

    Parameters
    ----------
    condition : callable
        (t, x, u, params) -> number; the event is where it passes 0.
    reset : callable, optional
        (t, x, u, params) -> all states of the block after the event.
    direction : {-1, 0, 1}
        Falling, either way, rising.
    name : str
    """

    condition: BlockFunction
    reset: BlockFunction | None
    direction: int
    name: str


def event(
    condition: BlockFunction,
    reset: BlockFunction | None = None,
    *,
    direction: Direction = "either",
    name: str = "event",
) -> Event:
    """An event of a continuous block, for :func:`hybrid`.

    Parameters
    ----------
    condition : callable
        (t, x, u, params) -> number. The event happens where it passes through 0.
    reset : callable, optional
        (t, x, u, params) -> list of all states of the block after the event, from those before it. None: the states
        stay; integration starts anew there, which is what a kink of the equations needs.
    direction : {"either", "rising", "falling"}
        Which way through 0 counts.
    name : str
        For messages and ``events`` of the response.

    Returns
    -------
    Event

    Raises
    ------
    TypeError
        If condition or reset are no functions.
    ValueError
        For another direction, or a name that is empty.

    Examples
    --------
    >>> event(lambda t, x, u, params: x[0], lambda t, x, u, params: [0.0, -0.8 * x[1]], direction="falling").direction
    -1
    """
    if not callable(condition) or not (reset is None or callable(reset)):
        raise TypeError("condition and reset: expected functions of (t, x, u, params); reset may be None")
    if direction not in _DIRECTIONS:
        raise ValueError(f"direction: expected one of {', '.join(_DIRECTIONS)}, got {direction!r}")
    if not name:
        raise ValueError("name: expected a name, got an empty one")
    return Event(condition, reset, _DIRECTIONS[direction], name)


class HybridBlock(ct.NonlinearIOSystem):
    """A continuous block with events; made by :func:`hybrid`.

    Parameters
    ----------
    system : control.InputOutputSystem
        The block between events.
    events : tuple of Event
    name : str
    """

    def __init__(self, system: ct.InputOutputSystem, events: tuple[Event, ...], name: str) -> None:
        super().__init__(
            self._refuse, self._refuse, inputs=system.input_labels, outputs=system.output_labels,
            states=system.state_labels, dt=0, name=name, params=_params(system),
        )  # fmt: skip
        self.system = system
        self.events = events

    def __deepcopy__(self, memo: dict[int, object]) -> HybridBlock:
        share(memo, self.system, self.events)
        return copied(self, memo)

    def parts(self) -> list[tuple[Event, ct.NonlinearIOSystem]]:
        """Each event as a system whose update is the reset and whose output is the condition."""
        labels = {"inputs": self.input_labels, "states": self.state_labels}
        params = _parameter_values(self.system)
        return [
            (
                entry,
                ct.NonlinearIOSystem(
                    entry.reset or _unchanged, entry.condition, outputs=["condition"], params=params, dt=0,
                    name=self.name, **labels,
                ),
            )
            for entry in self.events
        ]  # fmt: skip

    def _isstatic(self) -> bool:
        return False

    def _refuse(self, *_: object) -> NoReturn:
        raise TypeError(
            f"block {self.name!r} has events, which python-control cannot run: use phyfilter_ctl.simulate(diagram, "
            "timepts, inputs); its equations between events are in its attribute system"
        )

    def _rhs(self, t: float, x: ArrayLike, u: ArrayLike) -> NoReturn:
        self._refuse(t, x, u)

    def _out(self, t: float, x: ArrayLike, u: ArrayLike) -> NoReturn:
        self._refuse(t, x, u)


def hybrid(system: ct.InputOutputSystem, events: Sequence[Event], *, name: str | None = None) -> HybridBlock:
    """A continuous block with events: impacts, switches, hysteresis, contact.

    Parameters
    ----------
    system : control.InputOutputSystem
        Continuous, with states: ``control.nlsys``, ``control.ss``, :func:`plant` or :func:`function_block`. What is to
        remember something between events (a mode, a relay) is a state of it whose derivative is 0.
    events : sequence of Event
        Of several that happen together the resets are run in this order. A reset that makes another condition jump
        through 0 sets that event off too.
    name : str, optional
        Name of the block; None takes the system's.

    Returns
    -------
    HybridBlock
        For ``control.interconnect``; :func:`simulate`, :func:`export_c` and :func:`export_fmu` run it.

    Raises
    ------
    TypeError
        If the system is none of python-control's, or the events are none.
    ValueError
        For a discrete system, one without states, no events, or two of one name.

    Notes
    -----
    An event is located to the rounding of time, on the polynomial inside a step of integration, and the run goes on
    from the states after it. Events that follow each other without time in between (Zeno's paradox, a sliding mode) end
    the run with a status that names them. In the virtual machine a step is looked through in halves until the
    polynomial through the conditions tells where they pass 0, down to its 1024th part; C looks at eight parts of each
    step. Where a condition changes much faster than the states (a clock), ``max_step`` keeps the steps short.

    Examples
    --------
    A ball that loses a fifth of its speed where it hits the ground; it falls 1 m in 0.4515 s:

    >>> from phyfilter_ctl.simulation import simulate
    >>> fall = ct.nlsys(lambda t, x, u, p: [x[1], -9.81], None, inputs=0, outputs=2, states=["z", "v"], name="ball")
    >>> ground = event(lambda t, x, u, p: x[0], lambda t, x, u, p: [0.0, -0.8 * x[1]], direction="falling", name="hit")
    >>> response = simulate(hybrid(fall, [ground]), [0.0, 1.0], initial_state=[1.0, 0.0])
    >>> [(round(time, 4), name) for time, name in response.events]
    [(0.4515, 'hit')]
    """
    if not isinstance(system, ct.InputOutputSystem) or isinstance(
        system, ct.FrequencyResponseData | ct.InterconnectedSystem | HybridBlock
    ):
        raise TypeError(
            f"hybrid: expected one continuous block of python-control, got {type(system).__name__}; give the events to "
            "the block of a diagram whose states they concern"
        )
    if not all(isinstance(entry, Event) for entry in events):
        raise TypeError("events: expected a list of phyfilter_ctl.event(...)")
    if isinstance(system, ct.TransferFunction):
        system = ct.ss(system)
    name = name or system.name
    if system.dt not in (0, None):
        raise ValueError(f"{name}: expected a continuous block, got one with dt = {system.dt}")
    if not system.nstates:
        raise ValueError(
            f"{name}: expected a block with states, since events change or follow them; got none"
        )
    names = [entry.name for entry in events]
    if not names or len(set(names)) < len(names):
        raise ValueError(f"{name}: expected one event or more, each of its own name=, got {names}")
    return HybridBlock(system, tuple(events), name)


def _unchanged(t: float, x: Iterable[float], u: object, params: Mapping[str, Any]) -> object:
    return list(x)


def _params(system: ct.InputOutputSystem) -> dict[str, Any]:
    return dict(getattr(system, "params", {}))  # its stub says that not every system has them


def _parameter_values(system: ct.InputOutputSystem) -> dict[str, Any]:
    """Parameters as the block's functions read them: numbers, and arrays of indexed ones."""
    if not isinstance(system, FunctionBlock):
        return _params(system)
    values: dict[str, Any] = {}
    for variable in system.functions.parameters:
        bare, bracket, _ = variable.name.partition("[")
        if not bracket:
            values[variable.name] = variable.start
        else:
            values.setdefault(bare, []).append(variable.start)
    return {key: np.array(value) if isinstance(value, list) else value for key, value in values.items()}
