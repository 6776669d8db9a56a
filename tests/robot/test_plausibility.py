"""What is not plausible about a recording is found, and what is, is left alone."""

import numpy as np
import pytest

import phyfilter_ctl as pf

H = 0.01


def flight(seed: int = 0, *, noise: float = 2e-3) -> dict:
    """x' = g + f in three channels, g of gravity and a thrust that tilts, f small; every value at its sample."""
    t = H * np.arange(4000)
    rng = np.random.default_rng(seed)
    f = np.stack([0.5 * np.sin(1.3 * t), 0.4 * np.cos(0.7 * t), 0.3 * np.sin(2.0 * t)], axis=1)
    tilt = np.stack([0.3 * np.sin(0.9 * t), 0.25 * np.cos(1.2 * t)], axis=1)
    thrust = 9.81 * (1.0 + 0.1 * np.sin(3.0 * t))
    g = np.column_stack([thrust * tilt[:, 0], thrust * tilt[:, 1], thrust - 9.81])
    steps = 0.5 * (f + g + np.roll(f + g, -1, axis=0))
    x = np.cumsum(np.vstack([np.zeros(3), H * steps[:-1]]), axis=0)
    return {"dt": H, "x": x + noise * rng.standard_normal(x.shape), "g": g, "label": f}


def suspicions(**signals) -> list[str]:
    return [finding.suspicion for finding in pf.Recording.from_arrays(**signals).check()]


@pytest.mark.parametrize("seed", range(3))
def test_a_good_flight_is_left_alone(seed):
    given = flight(seed)
    assert suspicions(**given) == []
    assert suspicions(**given | {"label": None}) == []
    assert suspicions(**given | {"label": None, "g": None}) == []


@pytest.mark.parametrize("dt", [1e-6, 5.0, 1e4])
def test_steps_that_can_hardly_be_seconds(dt):
    assert suspicions(**flight() | {"dt": dt}) == ["time_unit"]
    log = pf.Recording.from_arrays(**flight() | {"dt": dt, "g": None, "label": None})
    assert log.check(time_unit_known=True).ok


def test_a_label_that_holds_what_g_should():
    given = flight()
    assert suspicions(**given | {"g": None}) == ["missing_g"]
    gravity = given["label"] - [0.0, 0.0, 9.81]
    (finding,) = pf.Recording.from_arrays(**given | {"g": None, "label": gravity}).check()
    assert finding.suspicion == "missing_g"
    assert "in x[2], as gravity would" in finding.message


def test_a_label_below_the_noise_is_left_alone():
    label = 1e-3 * flight()["label"]
    x = 0.1 * np.random.default_rng(5).standard_normal(label.shape)  # at rest
    assert suspicions(dt=H, x=x, label=label) == []


def test_a_label_of_another_sign_or_frame():
    given = flight()
    turned = given["g"][:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    (finding,) = pf.Recording.from_arrays(**given | {"g": turned}).check()
    assert finding.suspicion == "label_misfit"
    assert "with g turned from NED to ENU it fits" in finding.message
    (finding,) = pf.Recording.from_arrays(**given | {"g": -given["g"]}).check()
    assert "with -g it fits" in finding.message


def test_a_label_made_of_x_itself():
    given = flight()
    for label in (
        np.gradient(given["x"], H, axis=0),
        np.diff(given["x"], axis=0, append=given["x"][-1:]) / H,
    ):
        found = suspicions(dt=H, x=given["x"], label=label)
        assert found == ["label_is_derivative"]
    exact = flight(noise=0.0)  # smooth: nothing tells a derivative from the force itself
    assert suspicions(**exact) == []
    assert suspicions(dt=H, x=exact["x"], label=exact["label"] + exact["g"]) == []


def test_frames_and_mass_without_a_label():
    given = flight() | {"label": None}
    turned = given["g"] * [1.0, -1.0, -1.0]
    assert suspicions(**given | {"g": turned}) == ["wrong_frame"]
    assert suspicions(**given | {"inertia": 3.0}) == ["wrong_mass"]
    assert suspicions(**given | {"inertia": 1.1}) == []


def test_gaps_are_counted():
    given = flight()
    given["x"][50:60] = np.nan
    (finding,) = pf.Recording.from_arrays(**given, nonfinite="keep").check()
    assert finding.suspicion == "gaps"
    assert finding.message.startswith("10 of 4000 rows miss a signal")
    assert finding.to_dict() == {"suspicion": "gaps", "message": finding.message}
