"""Robot files: what is wrong in one is named by file and key, before any log is read."""

import re

import numpy as np
import pytest

from phyfilter_ctl.robot import Robot, describe_log, presets
from phyfilter_ctl.robot.expressions import Expression, constant
from tests.robot.flight import log_of

PLAIN = """
format = "phyfilter-robot"
version = 1
constants = { mass = 2.0 }
signals.v = { topic = "a", fields = ["vx", "vy", "vz"], unit = "m/s", frame = "NED" }
signals.u = { topic = "a", field = "u", unit = "N" }
expressions.force = "[0, 0, u]"
model = { x = "v", M = "mass", g = "force" }
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"phyfilter-robot"', '"phyfilter"', "format: expected 'phyfilter-robot'"),
        (
            "version = 1",
            "version = 2",
            "version: this file has version 2, this library reads version 1; update",
        ),
        ("constants =", "constnats =", "constnats: unknown key; did you mean 'constants'?"),
        ('unit = "N"', 'units = "N"', "signals.u.units: unknown key; did you mean 'unit'?"),
        ('unit = "N"', 'unit = "newton"', "signals.u.unit: not understood: 'newton'"),
        ('frame = "NED"', 'frame = "NDE"', "signals.v.frame: expected one of ENU, NED"),
        ('field = "u"', 'field = "u", fields = ["u"]', "signals.u.field: expected either"),
        ('unit = "N"', "gap = -1", "signals.u.gap: expected seconds above 0"),
        ('unit = "N"', 'between = "cubic"', "signals.u.between: expected one of hold, linear"),
        ('unit = "N"', 'rotation = "wxyz"', "signals.u.frames: an attitude has two"),
        ('"force" }', '"forec" }', "model.g: unknown name 'forec'; did you mean 'force'?"),
        ('"[0, 0, u]"', '"[0, 0, force]"', "expressions: force needs force: a circle"),
        ('"[0, 0, u]"', '"[0, 0, open(u)]"', "expressions.force: unknown function 'open'"),
        ('"[0, 0, u]"', '"u.real"', "expressions.force: 'u.real' is not allowed"),
        ('"[0, 0, u]"', '"[0, 0, u"', "expressions.force: no expression"),
        ('"[0, 0, u]"', '"rotate(u)"', "expressions.force: rotate: expected 2 arguments"),
        ('x = "v", ', "", "model.x: missing"),
        ('x = "v"', 'x = "mass"', "model.x: expected an expression of at least one signal"),
        ("version = 1", 'version = 1\npreset = "px4"', "preset: there is no 'px4'"),
        ("version = 1", 'version = 1\ntime_unit = "min"', "time_unit: expected one of"),
        ("mass = 2.0", "mass = nan", "constants.mass: expected a finite number"),
        ("mass = 2.0", "u = 2.0", "signals.u: is given twice"),
    ],
)
def test_what_is_wrong_is_named(load, old, new, said):
    assert old in PLAIN
    with pytest.raises(ValueError, match=f"robot.toml: {re.escape(said)}"):
        load(PLAIN.replace(old, new, 1))


T = np.arange(0.0, 3.0, 0.1)


def topics(**columns):
    given = {"vx": T, "vy": 2.0 * T, "vz": 3.0 * T, "u": 1.0 + T} | columns
    return {"a": (T, given)}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t.pop("a"), "signals.v.topic: f.ulg has no 'a'; expected one of b"),
        (lambda t: t["a"][1].pop("u"), "signals.u: f.ulg: topic 'a' has no field 'u'"),
        (lambda t: t["a"][0].__setitem__(9, 0.05), "signals.v: the clock of 'a' runs back"),
        (lambda t: t["a"][1].update(u=T * np.nan), "two samples of x at which everything is known"),
    ],
)
def test_what_a_log_has_not_is_named(load, change, said):
    given = topics()
    given["a"] = given["a"][0].copy(), given["a"][1]
    given["b"] = given["a"]
    change(given)
    with pytest.raises(ValueError, match=re.escape(said)):
        load(PLAIN).read(log_of("f.ulg", given))


def test_units_and_frames_come_out_in_si_and_enu(load):
    robot = load(PLAIN.replace('unit = "m/s"', 'unit = "km/h"').replace('unit = "N"', 'unit = "g"'))
    log = robot.read(log_of("f.ulg", topics()))
    np.testing.assert_allclose(log.x, np.stack([2.0 * T, T, -3.0 * T], axis=1) / 3.6)
    np.testing.assert_allclose(log.g[:-1, 2], 9.80665 * (1.05 + T[:-1]))
    assert np.all(log.inertia == 2.0)


def test_an_unknown_unit_or_a_slow_signal_is_asked_about(load):
    with pytest.raises(ValueError, match=r"signals\.u\.unit: missing: the log says none of 'u'"):
        load(PLAIN.replace(', unit = "N"', "")).read(log_of("f.ulg", topics()))
    with pytest.raises(ValueError, match=r"signals\.u\.gap: expected at least the 0\.1 s"):
        load(PLAIN.replace('unit = "N"', 'unit = "N", gap = 0.05')).read(log_of("f.ulg", topics()))
    without = PLAIN.replace(', frame = "NED"', "")
    with pytest.raises(ValueError, match=r"signals\.v\.frame: missing: of three columns, one of ENU"):
        load(without).read(log_of("f.ulg", topics()))


@pytest.mark.parametrize("name", presets())
def test_presets_are_complete_but_for_what_they_ask(load, name):
    text = f'format = "phyfilter-robot"\nversion = 1\npreset = "{name}"\n'
    constants = {"mass": 1.5, "motor_thrust": 7.0, "full_thrust": 0.6}
    asked = [key for key in constants if key in PRESET_ASKS[name]]
    if asked:
        with pytest.raises(
            ValueError, match=f"constants.{asked[0]}: missing: the preset '{name}' asks for it"
        ):
            load(text)
    values = ", ".join(f"{key} = {constants[key]}" for key in asked)
    robot = load(text + f"constants = {{ {values} }}\n")
    assert robot.preset == name
    assert {"x", "M", "g"} <= set(robot.model)
    # Taken out key by key, and changed.
    own = 'signals.extra = { field = "u", unit = "1" }\nmodel = { g = "none", label = "extra" }\n'
    changed = load(text + f"constants = {{ {values} }}\n" + own)
    assert "g" not in changed.model
    assert set(changed.signals) == {*robot.signals, "extra"}


PRESET_ASKS = {
    "ardupilot-copter": ("mass",),
    "arm": (),
    "crazyflie": ("mass", "full_thrust"),
    "legged-base": ("mass",),
    "px4-multirotor": ("mass", "motor_thrust"),
}


def test_expressions_are_arithmetic_per_sample():
    v = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    k = np.array([10.0, 20.0])
    values = {"v": v, "k": k, "A": constant([[1.0, 2.0, 3.0], [0.0, 1.0, 0.0]])}
    for text, expected in {
        "k * v": k[:, None] * v,
        "v[0] + v[-1]": v[:, 0] + v[:, 2],
        "v[0:2]": v[:, :2],
        "A @ v": v @ np.array([[1.0, 2.0, 3.0], [0.0, 1.0, 0.0]]).T,
        "A[0, 1] * k": 2.0 * k,
        "v @ v": np.sum(v * v, axis=1),
        "cross(v, [1, 0, 0])": np.cross(v, [1.0, 0.0, 0.0]),
        "norm(v) - sqrt(sum(v**2))": np.zeros(2),
        "clip(k, 0, 15)": np.array([10.0, 15.0]),
        "[[k, 0], [0, -k]][1, 1]": -k,
        "2 * pi": np.array([2.0 * np.pi]),
    }.items():
        np.testing.assert_allclose(Expression(text)(values), expected, atol=1e-14, err_msg=text)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os')", "().__class__", "lambda: 1", "[x for x in v]", "v if v else v", "v := 1", "'a' * 9",
        "True", "v[w]", "v[0.5]", "v.T", "sum(*v)", "sum(v, axis=0)", "v and v", "v < 1", "1j", "{1: 2}", "(" * 500,
        "-" * 3000 + "1", "",
    ],
)  # fmt: skip
def test_nothing_else_is_let_in(text):
    with pytest.raises(ValueError, match=r"expression|allowed|expected|function"):
        Expression(text)


def test_a_first_file_is_one_that_loads_once_it_is_filled_in(load):
    from tests.robot.flight import fly, px4_topics

    text = describe_log(log_of("flight.ulg", px4_topics(fly(1.0))))
    assert 'preset = "px4-multirotor"' in text
    assert 'mass = "FILL IN"    # kg' in text
    assert "vehicle_attitude: 126 samples, every 0.008 s" in text
    with pytest.raises(ValueError, match=r"constants\.mass: expected a number, got text: 'FILL IN'"):
        load(text)
    assert isinstance(load(text.replace('"FILL IN"', "1.5")), Robot)
    own = describe_log(log_of("mine.ulg", topics()))
    assert 'fields = ["vx", "vy", "vz"]' in own
    assert "[signals.force]    # FILL IN" in own  # u is one command, no force along three axes
    assert isinstance(load(own.replace('"FILL IN"', "1.5")), Robot)
