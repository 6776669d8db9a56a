"""What a separation says of recordings and declarations that are not what they were taken for."""

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.estimation import ColouredForce, Payload, SteadyForce

M, H, NOISE, WEIGHT = 3.0, 0.01, 0.01, 9.81
PARTS = [Payload(1.0, gravity=[WEIGHT]), ColouredForce(0.5, bandwidth=5.0, name="gusts")]


def lifted(payload: float = 0.6, *, gain: float = 1.0, gust: float = 0.5, seed: int = 0, n: int = 600):
    """Speed and known force of a mass that is lifted and lowered; Euler at a tenth of the step."""
    rng = np.random.default_rng(seed)
    v, w, speeds, forces = 0.0, 0.0, [], []
    for k in range(n):
        thrust = (M + 0.6) * (WEIGHT + 3.0 * np.cos(2.0 * k * H)) + 2.0 * np.sin(11.0 * k * H)
        speeds.append(v)
        forces.append(thrust - M * WEIGHT)
        for _ in range(10):
            w += 0.1 * H * (-5.0 * w) + gust * np.sqrt(1.0 * H) * rng.standard_normal()
            v += 0.1 * H * (gain * thrust - (M + payload) * WEIGHT + w) / (M + payload)
    return np.array(speeds) + NOISE * rng.standard_normal(n), np.array(forces)


def found(v, g, parts=PARTS, **options):
    log = pf.Recording.from_arrays(x=v, g=g, dt=H, inertia=M)
    return pf.separate(log, parts, noise=M * NOISE, **options)


def test_payload_without_known_forces_is_refused():
    v, _ = lifted()
    log = pf.Recording.from_arrays(x=v, dt=H, inertia=M)
    with pytest.raises(ValueError, match="expected g, the known forces that move what payload resists"):
        pf.separate(log, PARTS, noise=M * NOISE)


def test_parts_that_cannot_be_those_of_the_data_warn():
    v, g = lifted()
    with pytest.warns(UserWarning, match="mean square is .* and should be 1"):
        found(v, g, [Payload(1.0, gravity=[WEIGHT]), ColouredForce(1e-3, bandwidth=5.0)], sensitivity=False)


def test_reset_of_the_estimator_is_taken_out():
    """A jump of 0.5 m/s, 50 times the noise: the payload is as without it, to a tenth of its deviation."""
    v, g = lifted()
    jumped = v + np.where(np.arange(len(v)) >= 300, 0.5, 0.0)
    clean, reset = found(v, g), found(jumped, g)
    sd = clean.parts["payload"].sd_value[0]
    assert reset.parts["payload"].value[0] == pytest.approx(clean.parts["payload"].value[0], abs=0.1 * sd)
    assert reset.consistency == pytest.approx(clean.consistency, rel=0.05)
    assert any("steps taken out, up to t = 3 s" in note for note in reset.notes)
    assert not any("reset" in note for note in clean.notes)


def test_force_that_sets_in_and_wrong_sample_are_no_resets():
    v, g = lifted()
    pushed = v + np.where(np.arange(len(v)) >= 300, 5.0 * H * (np.arange(len(v)) - 299), 0.0)
    wrong = v + np.where(np.arange(len(v)) == 300, 0.5, 0.0)
    for each in (pushed, wrong):
        assert not any("reset" in note for note in found(each, g, sensitivity=False).notes)


def test_vehicle_that_never_left_the_ground_says_so():
    rng = np.random.default_rng(0)
    v, g = NOISE * rng.standard_normal(200), np.full(200, -0.3 * M * WEIGHT)
    notes = found(v, g, [Payload(1.0, gravity=[WEIGHT]), SteadyForce(20.0)], sensitivity=False).notes
    assert any("never left the ground" in note for note in notes)
    assert not any("never left the ground" in note for note in found(*lifted(), sensitivity=False).notes)


def test_weak_motor_is_in_the_notes():
    """3 % less force: payload wrong by 3 % of the whole mass, consistent all the same, and the note tells how far."""
    shift = 0.03 * (M + 0.6)
    weak = found(*lifted(gain=0.97, n=1500))
    value, sd = weak.parts["payload"].value[0], weak.parts["payload"].sd_value[0]
    assert value - 0.6 == pytest.approx(shift / 0.97, abs=3.0 * sd)
    [note] = [note for note in weak.notes if "scale of g" in note]
    assert f"shifts it by {0.03 * (M + value):.2g}" in note


def test_data_that_prefer_another_declaration_say_which():
    """Gusts of 0.5 N declared as 1.5 and as 0.5."""
    v, g = lifted()
    wide = found(v, g, [Payload(1.0, gravity=[WEIGHT]), ColouredForce(1.5, bandwidth=5.0, name="gusts")])
    assert any("prefer gusts: sd 3 times smaller" in note for note in wide.notes)
    assert not any("prefer" in note for note in found(v, g).notes)
    quiet = found(
        v, g, [Payload(1.0, gravity=[WEIGHT]), ColouredForce(1.5, bandwidth=5.0)], sensitivity=False
    )
    assert not any("prefer" in note for note in quiet.notes)


def test_answer_that_hangs_on_a_declaration_says_so():
    """A vertical wind of 3 N declared as 0.1 N, in hover: three times as large fits as well, and the payload moves."""
    rng = np.random.default_rng(3)
    n = 400
    thrust = M * WEIGHT + 3.0 + 0.05 * rng.standard_normal(n)
    v = np.cumsum(np.concatenate([[0.0], (thrust[:-1] - M * WEIGHT - 3.0) * H / M]))
    hover = found(
        v + NOISE * rng.standard_normal(n),
        thrust - M * WEIGHT,
        [Payload(1.0, gravity=[WEIGHT]), SteadyForce(0.1, name="vertical wind")],
    )
    assert any("depends" in note for note in hover.notes)
