"""Parameters by name, linearisation, description of a flat model."""

import control as ct
import numpy as np
import pytest

from phyfilter_ctl.blocks import sampled_block
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.plants import plant

EXACT = 1e-14


def car(t, x, u, p):
    return {"v": (u.force - p.drag * x.v * abs(x.v)) / p.mass}


def model():
    vehicle = plant(car, states={"v": (2.0, "m/s", "speed")}, inputs={"force": (1.0, "N")},
                    params={"mass": (4.0, "kg"), "drag": (0.5, "kg/m")}, name="car")  # fmt: skip
    gains = ct.nlsys(None, lambda t, x, u, params: params["k"] @ u, inputs=["r", "v"], outputs="force",
                     params={"k": np.array([[3.0, -3.0]]), "mass": 1.0}, name="gains")  # fmt: skip
    return ct.interconnect([vehicle, gains], inputs="r", outputs="v", name="cruise")


def test_plant_is_taken_as_it_is():
    flat = flatten(model())
    assert [(v.name, v.start, v.unit, v.description) for v in flat.states] == [("car.v", 2.0, "m/s", "speed")]
    assert flat.outputs[0].unit == "m/s"
    alone = flatten(model().syslist[0])
    assert (alone.inputs[0].unit, alone.inputs[0].start) == ("N", 1.0)
    assert alone.start_inputs().tolist() == [1.0]
    assert flat.start_state().tolist() == [2.0]


def test_parameters_by_name():
    flat = flatten(model())
    names = [v.name for v in flat.parameters]
    assert names == ["car.mass", "car.drag", "gains.k[0,0]", "gains.k[0,1]", "gains.mass"]
    changed = flat.start_parameters({"car.mass": 8.0, "drag": 1.0, "k": [[5.0, -5.0]]})
    assert changed.tolist() == [8.0, 1.0, 5.0, -5.0, 1.0]
    assert flat.start_parameters({"gains.k[0,1]": 7.0}).tolist() == [4.0, 0.5, 3.0, 7.0, 1.0]
    assert flat.start_parameters({"k[0,0]": 7.0})[2] == 7.0
    with pytest.raises(ValueError, match=r"mass belongs to several blocks: write car\.mass or gains\.mass"):
        flat.start_parameters({"mass": 1.0})
    with pytest.raises(ValueError, match=r"no parameter is called car\.mas; close to it: car\.mass"):
        flat.start_parameters({"car.mas": 1.0})
    with pytest.raises(ValueError, match="expected 2 numbers, got shape"):
        flat.start_parameters({"k": [1.0, 2.0, 3.0]})


def test_linearised_exactly():
    """v' = (3 (r - v) - drag v |v|) / mass."""
    linear = flatten(model()).linearize([2.0], [1.0], {"car.drag": 1.5})
    np.testing.assert_allclose(
        [linear.A.item(), linear.B.item()], [(-3 - 2 * 1.5 * 2.0) / 4, 3 / 4], rtol=EXACT
    )
    assert (linear.state_labels, linear.input_labels, linear.output_labels) == (["car_v"], ["r"], ["v"])
    start = flatten(model()).linearize()
    np.testing.assert_allclose(start.A.item(), (-3 - 2 * 0.5 * 2.0) / 4, rtol=EXACT)
    with pytest.raises(ValueError, match=r"x0: expected shape \(1,\), got \(2,\)"):
        flatten(model()).linearize([1.0, 2.0])
    with pytest.raises(ValueError, match=r"u0: expected shape \(1,\), got \(3,\)"):
        flatten(model()).linearize(u0=[1.0, 2.0, 3.0])


def test_linear_or_not():
    assert not flatten(model()).is_linear
    assert flatten(ct.tf([1.0], [1.0, 1.0])).is_linear
    offset = ct.nlsys(lambda t, x, u, params: -x + 1.0, None, inputs=1, outputs=1, states=1, name="offset")
    moving = ct.nlsys(lambda t, x, u, params: -t * x, None, inputs=1, outputs=1, states=1, name="moving")
    gain = ct.nlsys(
        None, lambda t, x, u, params: params["k"] ** 2 * u, inputs=1, outputs=1, params={"k": 2.0}, name="k"
    )
    assert [flatten(sys).is_linear for sys in (offset, moving, gain)] == [False, False, True]


def test_described():
    vehicle = model().syslist[0]
    law = sampled_block(ct.tf([1.0], [1.0, -0.5], 0.02, inputs="v", outputs="force", name="law"))
    text = flatten(
        ct.interconnect([vehicle, law], outputs="v", inputs=[], inplist=[], name="both")
    ).describe()
    lines = text.splitlines()
    assert lines[0] == "both (continuous): blocks law, car"
    assert "  car.mass              4  kg" in text
    assert "  car.v                 2  m/s      speed" in text
    assert lines[-2:] == ["sampled blocks, in the order in which they run", "  law                0.02  s"]
    assert flatten(ct.tf([1.0], [1.0, 0.5], 0.1, name="z")).describe().startswith("z (discrete, 0.1 s)")
