"""One gate: what no signal can be is refused through every door that takes signals, in words that name it.

Each kind of bad input comes in the shape of the good one, so that it is refused for what it is.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from phyfilter_ctl import Recording, baselines
from phyfilter_ctl.baselines import DisturbanceObserver
from tests.contracts.doors import DOORS, LOG, TIME_DOORS, TIMES, F, X


def masked(values: NDArray[np.float64]) -> np.ma.MaskedArray:
    mask = np.zeros(values.shape, bool)
    mask.flat[values.size // 2] = True
    return np.ma.array(values, mask=mask)


def changed(values: NDArray[np.float64], to: object, kind: type = float) -> NDArray[np.generic]:
    other = values.astype(kind)
    other.flat[values.size // 2] = to
    return other


KINDS: dict[str, Callable[[NDArray[np.float64]], object]] = {
    "dates": lambda v: np.datetime64("2024-05-01T10:00:00", "ns") + (1e9 * v).astype("timedelta64[ns]"),
    "lengths of time": lambda v: (1e9 * v).astype("timedelta64[ns]"),
    "complex": lambda v: v + 1e-3j,
    "complex without an imaginary part": lambda v: v + 0j,
    "text": lambda v: v.astype(str),
    "objects": lambda v: changed(v, None, object),
    "masked": masked,
    "list of masked": lambda v: list(masked(v)),
    "nan": lambda v: changed(v, np.nan),
    "inf": lambda v: changed(v, -np.inf),
    "empty": lambda v: v[:0],
}
# None at all may go in for these, or is refused in other words; poles are complex; flights that fail have infinite
# errors.
ALLOWED = {
    *((door, "empty") for door in ("zeros_at", "Chebyshev Xi", "Dictionary centres", "phase_lag omega")),
    *(
        (door, "empty")
        for door in ("simulate_batch k", "SerialArm points", "reachable points", "check_targets targets")
    ),
    *(
        (f"{door} poles", "complex without an imaginary part")
        for door in ("PhyFilter", "from_poles", "place_poles")
    ),
    *((f"{door} poles", "complex") for door in ("PhyFilter", "from_poles", "place_poles")),
    *((door, "inf") for door in ("median_interval values", "reduction ours", "reduction theirs")),
    *((door, "inf") for door in ("simulate k", "simulate_batch k")),  # a limit that never acts
}


def refusal(enter: Callable[..., object], bad: object) -> str:
    """What is said of it; "" where it is let in."""
    try:
        enter(bad)
    except (TypeError, ValueError) as error:
        return str(error)
    return ""


@pytest.mark.parametrize("door", DOORS)
def test_what_no_signal_can_be_is_refused(door: str) -> None:
    good, enter = DOORS[door]
    enter(good)
    for kind, make in KINDS.items():
        said = refusal(enter, make(good))
        if (door, kind) not in ALLOWED:
            assert re.search(r"\w+.*: .*(expected|must|got|not finite)", said), f"{kind}: {said}"
            assert re.search(r"[:;] .{6,}", said), f"{kind}: {said}"


@pytest.mark.parametrize("door", TIME_DOORS)
def test_what_no_time_can_be_is_refused(door: str) -> None:
    TIME_DOORS[door](TIMES)
    for kind, make in KINDS.items():
        if kind not in ("dates", "lengths of time"):
            said = refusal(TIME_DOORS[door], make(TIMES))
            assert re.match(r"(times|timepts): ", said), f"{kind}: {said}"


@pytest.mark.parametrize("door", TIME_DOORS)
def test_times_run_forwards(door: str) -> None:
    if door != "envelope times":  # at any times, in any order
        with pytest.raises(
            ValueError, match=r"^(times|timepts): expected increasing times, got row 5 .*runs back"
        ):
            TIME_DOORS[door]([*TIMES[:-1], 0.03])


@pytest.mark.parametrize(
    "value", [np.datetime64("2024-05-01"), 1j, "0.1", None, np.ma.masked, np.nan, [0.1, 0.2], -0.1]
)
@pytest.mark.parametrize(
    "door",
    [
        lambda dt: Recording.from_arrays(x=X, dt=dt),
        lambda dt: LOG.resample(dt),
        F.sampled,
        lambda dt: DisturbanceObserver(8.0, dt),
        lambda dt: baselines.BackwardDifference(2).estimate(X, dt),
    ],
)
def test_what_no_sampling_interval_can_be_is_refused(door: Callable[..., object], value: object) -> None:
    with pytest.raises((TypeError, ValueError), match="dt"):
        door(value)
