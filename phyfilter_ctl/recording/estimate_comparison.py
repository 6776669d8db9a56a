"""Estimates of f beside the label of a flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import control as ct
import numpy as np
from matplotlib.axes import Axes

from .._sections import FloatArray
from ..results import Result

__all__ = ["EstimateComparison"]


@dataclass(frozen=True, eq=False, repr=False)
class EstimateComparison(Result):
    """Estimates of f beside the label; made by ``Recording.compare``.

    Attributes
    ----------
    times : (N,) array
        Seconds.
    label : (N, n_x) array
        The true f.
    estimates : dict of str to (N, n_x) array
    channels : tuple of str
    unit : str
        Of f; empty where it is not known.
    """

    _figures = ("channels", "unit", "rmse", "channel_rmse")
    _units = MappingProxyType({"rmse": "{}", "channel_rmse": "{}"})

    times: FloatArray
    label: FloatArray
    estimates: dict[str, FloatArray]
    channels: tuple[str, ...]
    unit: str

    @cached_property
    def errors(self) -> dict[str, FloatArray]:
        """label - estimate, (N, n_x) each."""
        return {name: self.label - values for name, values in self.estimates.items()}

    @cached_property
    def channel_rmse(self) -> dict[str, FloatArray]:
        """Root-mean-square error of each channel, (n_x,) each; without the first sample, f_hat = f_theta, and gaps."""
        return {name: np.sqrt(np.nanmean(values[1:] ** 2, axis=0)) for name, values in self.errors.items()}

    @cached_property
    def rmse(self) -> dict[str, float]:
        """Root-mean-square error over samples and channels; without the first sample, where f_hat = f_theta."""
        return {name: float(np.sqrt(np.nanmean(values[1:] ** 2))) for name, values in self.errors.items()}

    def plot(self, *, ax: Sequence[Axes] | None = None) -> ct.ControlPlot:
        """Label and estimates of each channel over time, above a strip with the errors and their RMSE.

        Parameters
        ----------
        ax : 2 n_x Axes, optional
            For each channel one for the signals and one for the errors; None makes a new figure.

        Returns
        -------
        control.ControlPlot

        Raises
        ------
        ValueError
            If ``ax`` does not hold 2 n_x axes.
        """
        from ..plots.estimates import estimate_plot

        return estimate_plot(
            self.times,
            self.label,
            self.estimates,
            self.errors,
            self.channel_rmse,
            channels=self.channels,
            unit=self.unit,
            totals=self.rmse if len(self.channels) > 1 else None,
            ax=ax,
        )
