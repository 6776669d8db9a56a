"""A sampled filter as it runs: whole records, and loops one sample at a time."""

from __future__ import annotations

from typing import cast

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import loop, record
from .loop import FilterState
from .matrices import sampled_state_space
from .record import Log
from .recursion import Recursion
from .sampling import Sampling


class SampledForm:
    """What runs on the recursion alone, whatever filter it came from; see :class:`SampledPhyFilter`."""

    sampling: Sampling
    recursion: Recursion

    @property
    def dt(self) -> float:
        """Nominal sampling interval in seconds."""
        return self.sampling.dt

    # -- whole records ------------------------------------------------------------------------------------------

    def run(
        self,
        x: ArrayLike | Log,
        g: ArrayLike | None = None,
        f_theta: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
        times: ArrayLike | None = None,
    ) -> NDArray[np.floating]:
        """f_hat over a whole record.

        Signals and times may be frames, series or labelled arrays of pandas, polars and xarray. Their rows go by
        position: an index is not looked at, give it as ``times``. Columns of float64 in one block are not copied.

        Parameters
        ----------
        x : (N, n_x) array, or a recording
            Measured state; (N,) for one channel, as for the other signals. A recording brings x, g, f_theta, times and,
            before that of the filter, its inertia.
        g : (N, n_x) array, optional
            Known part of M x'. With ``g="hold"``, ``run``, blocks and FMUs take the g that acts from this sample on
            (row k from sample k on); ``step``, ``live.step`` and C take the g that acted since the last sample. With
            ``g="average"`` all take g at this sample. None means 0.
        f_theta : (N, n_f) array, optional
            Learned model of f; None means 0.
        inertia : float, (n_x,), (n_x, n_x), (N, n_x) or (N, n_x, n_x) array, optional
            Model M_hat of the inertia: scalar, diagonal or full, constant or per sample; None takes that of
            ``sampling``, else I.
        times : (N,) array, optional
            Sampling instants where they are not every ``dt``: seconds, timedelta64, or datetime64 and datetime
            objects counted from the first, with time zones in UTC. After more than 20 nominal steps without a good
            sample the filter goes on from the next one, without a step to it.

        Returns
        -------
        (N, n_f) array
            f_hat in the precision of the filter; row 0 is f_theta. (N, 1) for x of (N,).

        Raises
        ------
        TypeError
            For a signal that is not of real numbers (a frame's columns are named), times that are text, or with
            and without a time zone, and signals beside a recording.
        ValueError
            For wrong shapes, an ambiguous inertia (2-D with N == n_x), times that stand still or run back (row
            named), have steps most of which are gaps or are whole numbers that count no seconds, a recording in
            another unit or with its channels in another order, a sample that is not finite, is masked or is beyond
            1e150 under ``nonfinite="raise"`` (row and signal named), or a step at which forward Euler diverges.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> PhyFilter([20.0]).sampled(0.01).run([[0.0], [0.01], [0.02]], f_theta=[[1.0], [1.0], [1.0]]).ravel()
        array([1., 1., 1.])
        """
        if record.is_log(x):
            if any(signal is not None for signal in (g, f_theta, inertia, times)):
                raise TypeError(
                    "g, f_theta, inertia, times: expected none beside a recording, which has its own; change "
                    "those with recording.with_signals, or give x and all signals as arrays"
                )
            return record.run_log(self.recursion, x)
        return record.run(self.recursion, cast(ArrayLike, x), g, f_theta, inertia, times)

    def estimate(self, recording: Log, /) -> NDArray[np.floating]:
        """f_hat of a recording: :meth:`run` by the name that every estimator has, the baselines too.

        Parameters
        ----------
        recording : Recording

        Returns
        -------
        (N, n_f) array

        Raises
        ------
        TypeError, ValueError
            As for :meth:`run`.
        """
        if not record.is_log(recording):
            raise TypeError(
                f"recording: expected a Recording, got {type(recording).__name__}; run(x) takes arrays"
            )
        return self.run(recording)

    def held(
        self,
        x: ArrayLike,
        g: ArrayLike | None = None,
        f_theta: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
    ) -> NDArray[np.bool_]:
        """Which samples of a record ``run`` holds because they are not finite.

        Parameters
        ----------
        x, g, f_theta, inertia
            As for :meth:`run`.

        Returns
        -------
        (N,) bool array

        Raises
        ------
        ValueError
            For wrong shapes.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> PhyFilter([20.0]).sampled(0.01, nonfinite="hold").held([[0.0], [float("nan")], [0.0]])
        array([False,  True, False])
        """
        return record.held_samples(
            self.recursion, *record.checked_signals(self.recursion, x, g, f_theta, inertia)
        )

    # -- loops --------------------------------------------------------------------------------------------------

    def start(
        self,
        x0: ArrayLike,
        *,
        f_hat0: ArrayLike | None = None,
        f_theta0: ArrayLike | None = None,
        inertia0: ArrayLike | None = None,
        g0: ArrayLike | None = None,
    ) -> FilterState:
        """State at the first sample, from which f_hat starts bumplessly.

        Parameters
        ----------
        x0 : (n_x,) or (..., n_x) array
            First measurement; leading axes are systems that run side by side, in all that follows too.
        f_hat0 : (n_f,) array, optional
            Estimate to start from (the filter at rest on the constant residual that gives it); None means f_theta0.
        f_theta0 : (n_f,) array, optional
            f_theta at the first sample; None means 0.
        inertia0 : float, (n_x,) or (n_x, n_x) array, optional
            Inertia at the first sample, kept until ``step`` is given another; None takes that of ``sampling``, else I.
        g0 : (n_x,) array, optional
            g at the first sample, used by ``g="average"``; None takes the g of the first step. With ``g="hold"`` no g
            has acted yet: ``step`` takes the g that acted since the last sample.

        Returns
        -------
        FilterState
            Immutable; hand it to ``step``.

        Raises
        ------
        ValueError
            For wrong shapes or non-finite values, or where F(0) = 0 and no constant residual gives f_hat0.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> sampled = PhyFilter([20.0]).sampled(0.002)
        >>> state = sampled.start([0.0, 0.0], f_hat0=[1.0, -1.0])
        >>> state, f_hat = sampled.step(state, [0.002, -0.002], [0.0, 0.0], [0.0, 0.0])
        >>> f_hat.round(12).tolist()
        [1.0, -1.0]
        """
        return loop.start(self.recursion, x0, f_hat0=f_hat0, f_theta0=f_theta0, inertia0=inertia0, g0=g0)

    def step(
        self,
        state: FilterState,
        x: ArrayLike,
        g: ArrayLike | None = None,
        f_theta: ArrayLike | None = None,
        *,
        inertia: ArrayLike | None = None,
        dt: float | None = None,
    ) -> tuple[FilterState, NDArray[np.floating]]:
        """Advance by one sample. Pure: the state given is not changed.

        Of many systems side by side, x, g, f_theta and f_hat have the leading axes of the start; an inertia serves all,
        or is a diagonal (..., n_x) or a matrix (..., n_x, n_x) of each.

        Parameters
        ----------
        state : FilterState
        x : (n_x,) array
            Measurement now.
        g : (n_x,) array, optional
            With ``g="hold"``, ``step``, ``live.step`` and C take the g that acted since the last sample, that is the
            command sent then, so the command of this sample may depend on the f_hat returned here; ``run``, blocks and
            FMUs take the g that acts from this sample on. With ``g="average"`` all take g at this sample. None means 0.
        f_theta : (n_f,) array, optional
            Learned model now; None means 0.
        inertia : float, (n_x,) or (n_x, n_x) array, optional
            Inertia now; None keeps the last one.
        dt : float, optional
            Length of the step that ends now; None means the nominal one.

        Returns
        -------
        state : FilterState
            ``state.held`` tells whether this sample was held (``nonfinite="hold"``).
        f_hat : (n_f,) array

        Raises
        ------
        ValueError
            For wrong shapes, a step that is not positive or at which forward Euler diverges, or a non-finite
            sample under ``nonfinite="raise"`` (of many systems, the first is named).

        Examples
        --------
        ``run`` is this loop:

        >>> from phyfilter_ctl import PhyFilter
        >>> import numpy as np
        >>> rng = np.random.default_rng(1)
        >>> x, g, f_theta = rng.standard_normal((3, 50, 2))
        >>> sampled = PhyFilter([400.0, 40.0]).sampled(0.002)
        >>> state = sampled.start(x[0], f_theta0=f_theta[0])
        >>> for k in range(1, 50):
        ...     state, f_hat = sampled.step(state, x[k], g[k - 1], f_theta[k])
        >>> bool(np.allclose(f_hat, sampled.run(x, g, f_theta)[-1], rtol=1e-12))
        True
        """
        return loop.step(self.recursion, state, x, g, f_theta, inertia=inertia, dt=dt)

    def shift_x(self, state: FilterState, dx: ArrayLike) -> FilterState:
        """Tell the filter that the estimate of x jumped by dx (n_x,): a reset, not an acceleration.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> sampled = PhyFilter([20.0]).sampled(0.002)
        >>> state = sampled.shift_x(sampled.start([0.0]), [0.5])
        >>> sampled.step(state, [0.5])[1].tolist()
        [0.0]
        """
        return loop.shift_x(state, dx)

    # -- as python-control systems ------------------------------------------------------------------------------

    def to_ss(self, channels: int | None = None, *, inertia: ArrayLike | None = None) -> ct.StateSpace:
        """The recursion as a discrete python-control state space: what ``run`` does with constant inertia.

        Parameters
        ----------
        channels : int, optional
            Number n_x of channels of x; None means as many as ``sampling``, E or one filter per channel tell, else 1.
        inertia : float, (n_x,) or (n_x, n_x) array, optional
            Constant inertia M_hat; None takes that of ``sampling``, else I.

        Returns
        -------
        control.StateSpace
            Inputs x[i], g[i], f_theta[i] (all x first, then all g, then all f_theta), outputs f_hat[i]. From state 0
            it has zeros before the first sample; ``phyfilter_block(...).rest_state`` is the start of ``run``.

        Raises
        ------
        ValueError
            For a contradictory number of channels, a wrong inertia, or an option that no linear system has (limit,
            g_limit, nonfinite="hold").

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> system = PhyFilter([20.0]).sampled(0.002).to_ss()
        >>> system.dt, system.input_labels, system.output_labels
        (0.002, ['x[0]', 'g[0]', 'f_theta[0]'], ['f_hat[0]'])
        """
        return sampled_state_space(self.recursion, channels, inertia)

    def to_tf(self, channels: int | None = None, *, inertia: ArrayLike | None = None) -> ct.TransferFunction:
        """The recursion as transfer functions in z from x, g and f_theta to f_hat.

        Parameters
        ----------
        channels, inertia
            As for :meth:`to_ss`.

        Returns
        -------
        control.TransferFunction
            One row per f_hat[i], one column per input, as :meth:`to_ss` has them.

        Raises
        ------
        ValueError
            As :meth:`to_ss`.

        Notes
        -----
        Slow poles, that is e^(p dt) close to 1, take digits from the coefficients; the state space keeps them.

        Examples
        --------
        >>> from phyfilter_ctl import PhyFilter
        >>> system = PhyFilter([20.0]).sampled(0.002).to_tf()
        >>> system.den[0][1].round(6).tolist()
        [1.0, -0.960789]
        """
        return ct.TransferFunction(ct.ss2tf(self.to_ss(channels, inertia=inertia)))
