"""A result shows its answer: in its repr, in its text, in one line within another one; with units where it has them."""

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import margins

UNITS = {"x": "m/s", "g": "N", "f": "N"}
LOOP = {"kp": 10.0, "kd": 6.0}
SAMPLED = pf.PhyFilter([5.0]).sampled(0.01, units=UNITS)
LAG = ct.tf(1, [0.05, 1])

# Of each: how it is made, and the figure that it is asked for.
MADE = {
    "bound": (lambda: pf.error_bound(SAMPLED, pf.Bounded({1: 3.0}, noise=0.01)), "bound"),
    "variance": (lambda: pf.error_variance(SAMPLED, pf.Gaussian(noise=0.01)), "error"),
    "prior": (lambda: pf.margins(pf.PhyFilter([5.0]), pf.Loop(delay=0.02)), "modulus_margin"),
    "loop": (lambda: pf.margins(pf.PhyFilter([5.0]), pf.Loop(delay=0.02, **LOOP)), "delay_margin"),
    "saturation": (lambda: pf.saturation_margin(SAMPLED, pf.Loop(**LOOP)), "command_excess"),
    "tube": (lambda: pf.tracking_error(SAMPLED, pf.Loop(**LOOP), {0: 1.0}), "radius"),
    "deviation": (lambda: pf.tracking_error(SAMPLED, pf.Loop(**LOOP), pf.Gaussian(noise=0.01)), "position"),
    "inertia": (lambda: pf.inertia_tolerance(SAMPLED, ratios=(0.5, 1.5)), "status"),
    "bandwidth": (
        lambda: pf.largest_bandwidth(lambda w: pf.PhyFilter([w]), pf.Loop(actuator=LAG, delay=0.02)),
        "limit",
    ),
    "disk": (lambda: margins(ct.tf(1, [1, 1, 0])).disk, "alpha"),
}
UNIT_OF = {"bound": "N", "variance": "N^2", "loop": "s", "bandwidth": "rad/s", "tube": "m", "deviation": "m"}


@pytest.mark.parametrize("name", MADE)
def test_the_answer_is_in_the_repr_and_in_one_line(name):
    make, figure = MADE[name]
    result = make()
    value = getattr(result, figure)
    shown = f"{figure}={str(value)!r}" if isinstance(value, str) else f"{figure}={value:.6g}"
    assert result.figures()[figure] == (value, UNIT_OF.get(name, ""))
    shown += f" {UNIT_OF[name]}" if name in UNIT_OF else ""
    assert f"    {shown},\n" in repr(result)
    assert pf.results.plain(value) == result.to_dict()[figure]
    inside = pf.results.summary(result)
    assert shown in inside
    assert "\n" not in inside


@pytest.mark.parametrize("name", MADE)
def test_the_answer_is_in_the_text(name):
    make, figure = MADE[name]
    result = make()
    text = result.describe()
    value = getattr(result, figure)
    if name == "variance":  # as a deviation
        value = value**0.5
    if figure == "delay_margin":  # in ms
        value = 1e3 * value
    digits = 6 if name == "bound" else 4
    expected = value if isinstance(value, str) else f"{value:.{digits}g}"
    assert expected in text
    assert not any(code in text for code in ("array(", "()", "None", "entries of type"))


def test_texts_have_the_units_of_the_filter():
    found = {name: MADE[name][0]().describe() for name in ("bound", "variance", "tube", "deviation")}
    assert " N = residual" in found["bound"]
    assert found["variance"].splitlines()[0].endswith(" N (1 sigma)")
    # x in m/s: its integral is in m.
    assert found["tube"].splitlines()[0].endswith(" m")
    assert found["tube"].splitlines()[-1].endswith(" N")
    assert found["deviation"].splitlines()[0].endswith(" m (1 sigma)")
    plain = pf.PhyFilter([5.0]).sampled(0.01)
    for described in (
        pf.error_bound(plain, {1: 3.0}).describe(),
        pf.tracking_error(plain, pf.Loop(**LOOP), {0: 1.0}).describe(),
    ):
        assert " N" not in described
        assert not any(line.endswith(" ") for line in described.splitlines())


def test_what_has_no_answer_says_so():
    unstable = margins(ct.tf(1, [1, 1, 0]) * 0 + ct.tf(-3, [1, 1])).disk
    assert unstable.describe().endswith("unstable")
    none = pf.largest_bandwidth(
        lambda w: pf.PhyFilter([w]), pf.Loop(delay=0.02), modulus_margin=0.999, low=50.0
    )
    assert none.describe().startswith("bandwidth up to     none")
    assert np.isnan(none.limit)


def test_several_texts_are_shown_as_texts():
    text = repr(pf.error_bound(SAMPLED, {1: 3.0}))
    assert "entries of type str" not in text
    assert "assumptions=('g is held between the samples', " in text
