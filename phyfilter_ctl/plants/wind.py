"""Wind as a drone meets it: a mean, the jet of a fan, and gusts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .algebra import Array, cross, dot, norm, stack
from .declaration import Columns
from .factory import Plant, Results, plant

__all__ = ["wind_field"]

# Coarser noise than this share of the gusts' time constant L/V would show in their variance, by its square / 12.
_LARGEST_INTERVAL = 0.2


def wind_field(
    *,
    mean: ArrayLike = (0.0, 0.0, 0.0),
    jet_speed: float = 0.0,
    jet_origin: ArrayLike = (0.0, 0.0, 0.0),
    jet_direction: ArrayLike = (1.0, 0.0, 0.0),
    jet_width: float = 0.5,
    turbulence: float = 0.0,
    length_scale: float = 1.0,
    airspeed: float | None = None,
    noise_interval: float = 0.002,
    name: str = "wind",
) -> Plant:
    """Wind at a place: mean wind, the jet of a fan, and Dryden gusts in proportion to both.

        wind = U(r) + turbulence |U(r)| (n_1 e_1 + n_2 e_2 + n_3 e_3)
        U(r) = mean + jet_speed exp(-(rho/width)^2/2) (1 + tanh(2 s/width))/2 d

    s is the distance downstream of the fan along the jet's axis d, rho that from the axis. e_1 points along U, e_2 is
    horizontal and to its left, e_3 = e_1 x e_2. n_1, n_2, n_3 are filtered white noise of unit variance, with
    tau = length_scale/airspeed:

        along:   sqrt(2 tau)/(1 + tau s),      across:   sqrt(tau) (1 + sqrt(3) tau s)/(1 + tau s)^2

    Parameters
    ----------
    mean : (3,) array
        Mean wind far from the jet in m/s, world frame.
    jet_speed : float
        Speed on the jet's axis in m/s.
    jet_origin : (3,) array
        Centre of the fan in m, world frame; the jet has half its speed there.
    jet_direction : (3,) array
        Direction d in which the fan blows, of any length.
    jet_width : float
        Standard deviation of the profile in m.
    turbulence : float
        Standard deviation of each component of the gusts over the local mean speed |U|.
    length_scale : float
        L in m.
    airspeed : float, optional
        Speed V in m/s with which the gusts pass by. It is one number, so that the filters stay linear. None means
        jet_speed, or |mean| without a jet, or 1 without either.
    noise_interval : float
        Seconds for which each sample of the noise is held.
    name : str
        Name of the block.

    Returns
    -------
    Plant
        Inputs r (m, world) and noise[i] (white, unit variance, each sample held for noise_interval); output wind
        (m/s, world). All numbers above are parameters. The gusts start at 0 and have 98 % of their standard deviation
        after 2 tau.

    Raises
    ------
    ValueError
        For vectors that are not three finite numbers, a direction of length 0, a negative speed or turbulence, a
        width, length or interval that is not positive, or noise held for longer than tau/5.

    Notes
    -----
    Dryden spectra as in MIL-F-8785C, section 3.7.2.2, isotropic: one length scale and one standard deviation for the
    three components (L is L_u = L_v = L_w there, and L_u = 2 L_v = 2 L_w in MIL-HDBK-1797). The forms for low
    altitudes, which depend on the height over open ground, do not describe a fan. Gusts of rates are left out, and the
    gust is that of one point that the air passes at V (frozen turbulence), wherever the drone flies.

    Noise samples of unit variance, divided by sqrt(noise_interval), stand for white noise of unit intensity. Held for
    T, they leave the variance too small by (T/tau)^2/12 of its value along the wind.

    The jet does not widen downstream. Where U is vertical, e_2 is the world's y axis.

    Examples
    --------
    >>> fan = wind_field(jet_speed=4.0, jet_origin=[-3.0, 0.0, 1.0])
    >>> fan.output(0.0, fan.start_state, [0.0, 0.5, 1.0, 0.0, 0.0, 0.0]).round(3).tolist()
    [2.426, 0.0, 0.0]
    """
    vectors = {
        label: _signals.array(label, values, (3,))
        for label, values in (
            ("mean", mean),
            ("jet_origin", jet_origin),
            ("jet_direction", jet_direction),
        )
    }
    if not vectors["jet_direction"].any():
        raise ValueError("jet_direction: expected a vector other than 0, such as (1, 0, 0) for a jet along x")
    for label, value, unit in (
        ("jet_speed", jet_speed, "m/s, along jet_direction"),
        ("turbulence", turbulence, ""),
    ):
        _signals.number(label, value, unit, least=0.0)
    speed = airspeed if airspeed is not None else jet_speed or float(np.linalg.norm(vectors["mean"])) or 1.0
    for label, value, unit in (
        ("jet_width", jet_width, "m"),
        ("length_scale", length_scale, "m"),
        ("airspeed", speed, "m/s"),
        ("noise_interval", noise_interval, "s"),
    ):
        _signals.number(label, value, unit, above=0.0)
    longest = _LARGEST_INTERVAL * length_scale / speed
    if turbulence > 0.0 and noise_interval > longest:
        raise ValueError(
            f"noise_interval: expected at most {longest:.4g} s, a fifth of length_scale/airspeed, got "
            f"{noise_interval:g} s: the gusts would be too weak; give noise more often, or a longer length_scale"
        )
    return plant(
        _equations,
        name=name,
        states={
            "along": (0.0, "", "gust along the wind"),
            "across": (np.zeros(2), "", "gusts across the wind, first lag"),
            "across_late": (np.zeros(2), "", "gusts across the wind, second lag"),
        },
        inputs={
            "r": (np.zeros(3), "m", "position, world"),
            "noise": (np.zeros(3), "", "white noise of unit variance, held"),
        },
        outputs={"wind": ("m/s", "wind, world")},
        params={
            "mean": (vectors["mean"], "m/s", "mean wind, world"),
            "jet_speed": (jet_speed, "m/s", "speed on the jet's axis"),
            "jet_origin": (vectors["jet_origin"], "m", "centre of the fan, world"),
            "jet_direction": (vectors["jet_direction"], "", "direction of the jet, world"),
            "jet_width": (jet_width, "m", "standard deviation of the jet's profile"),
            "turbulence": (turbulence, "", "gusts over the local mean speed"),
            "length_scale": (length_scale, "m", "length scale of the gusts"),
            "airspeed": (speed, "m/s", "speed at which gusts pass by"),
            "noise_interval": (noise_interval, "s", "time for which noise is held"),
        },
    )


def _equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
    tau = p.length_scale / p.airspeed
    noise = u.noise / np.sqrt(p.noise_interval)
    derivatives: Results = {
        "along": (np.sqrt(2.0 * tau) * noise[0] - x.along) / tau,
        "across": (np.sqrt(tau) * noise[1:] - x.across) / tau,
        "across_late": (x.across - x.across_late) / tau,
    }
    # (1 + sqrt(3) tau s)/(1 + tau s)^2 in partial fractions, so that both lags are well conditioned.
    across = np.sqrt(3.0) * x.across + (1.0 - np.sqrt(3.0)) * x.across_late
    steady = _mean_wind(u.r, p)
    left = _left_of(steady)
    gust = x.along * steady + across[0] * norm(steady) * left + across[1] * cross(steady, left)
    return derivatives, {"wind": steady + p.turbulence * gust}


def _mean_wind(r: Array, p: Columns) -> Array:
    axis = p.jet_direction / norm(p.jet_direction)
    offset = r - p.jet_origin
    downstream = dot(offset, axis)
    beside = offset - downstream * axis
    profile = np.exp(-0.5 * dot(beside, beside) / p.jet_width**2)
    begun = 0.5 * (1.0 + np.tanh(2.0 * downstream / p.jet_width))
    return p.mean + p.jet_speed * profile * begun * axis


def _left_of(wind: Array) -> Array:
    """Horizontal unit vector to the left of the wind; y where the wind is vertical."""
    level = norm(wind[:2])
    vertical = 1.0 - np.sign(level)
    length = level + vertical
    return stack(-wind[1] / length, wind[0] / length + vertical, 0.0)
