"""What cannot be flattened is refused with the block's name and the way out."""

import warnings

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, margins, phyfilter_block, sampled_block
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.simulation import simulate


def static(function, name="block", **names):
    names = {"inputs": "u", "outputs": "y"} | names
    return ct.nlsys(None, function, name=name, **names)


def dynamic(update, name="block", states=1, params=None):
    return ct.nlsys(update, None, inputs=1, outputs=states, states=states, params=params, name=name)


def test_block_that_remembers():
    """A delay written with a list is a state that python-control does not know of."""
    past = [0.0]

    def delay(t, x, u, params):
        past.append(float(u[0]))
        return past[-2]

    with pytest.raises(ValueError, match="keeps something from call to call"):
        flatten(static(delay, "late"))


def test_functions_that_fail_or_never_are_finite():
    with pytest.raises(
        ValueError, match=r"block block: its output function fails wherever it is called: .*out of bounds"
    ):
        flatten(static(lambda t, x, u, params: u[3]))
    with pytest.raises(ValueError, match="not finite at any probed point"):
        flatten(static(lambda t, x, u, params: np.sqrt(-1 - u**2)))
    with pytest.raises(ValueError, match="gives 2 entries, expected 1"):
        flatten(static(lambda t, x, u, params: [u[0], u[0]]))


def test_things_that_are_no_blocks():
    with pytest.raises(TypeError, match="phyfilter_block"):
        flatten(PhyFilter([20.0]).sampled(0.01))
    frd = ct.frd(np.array([1.0 + 0j, 0.5]), np.array([1.0, 2.0]), name="measured")
    with pytest.raises(TypeError, match="block measured: frequency response data"):
        flatten(frd)


def test_transfer_functions():
    with pytest.raises(ValueError, match=r"block lead: .* proper"):
        flatten(ct.tf([1.0, 0.0, 0.0], [1.0, 1.0], name="lead"))
    # Inside a diagram python-control speaks first.
    with pytest.raises(ValueError, match=r"[Ii]mproper|non-proper"):
        ct.interconnect([ct.tf([1.0, 0.0, 0.0], [1.0, 1.0], name="lead")], inplist="lead", outlist="lead")


def test_discrete_without_interval():
    with pytest.raises(ValueError, match="unknown: it is discrete with an unknown sampling interval"):
        flatten(ct.tf([1.0], [1.0, 0.5], True, name="unknown"))


def test_sizes_left_open():
    with pytest.raises(ValueError, match="block open: the numbers of inputs, outputs and states"):
        flatten(ct.nlsys(lambda t, x, u, params: -x, None, name="open"))


def test_matrices_that_are_not_finite():
    with pytest.raises(ValueError, match="block bad: its state-space matrices are not real and finite"):
        flatten(ct.ss([[np.nan]], [[1.0]], [[1.0]], [[0.0]], name="bad"))


def lag(name, u, y):
    return ct.tf([1.0], [1.0, 1.0], inputs=u, outputs=y, name=name)


def test_unconnected_input():
    two = static(lambda t, x, u, params: u[0] + u[1], "two", inputs=["y", "d"], outputs="z")
    with pytest.warns(UserWarning, match="Unused input"):
        sys = ct.interconnect([lag("lag", "u", "y"), two], inputs="u", outputs="z", name="open")
    with pytest.raises(ValueError, match=r"nothing drives two\.d\..*unconnected=\"zero\""):
        flatten(sys)
    flat = flatten(sys, unconnected="zero")
    assert flat.undriven == ("two.d",)
    assert float(flat.output(0, [3.0], [1.0], [], [])) == float(sys.output(0, [3.0], [1.0])[0])
    with pytest.raises(ValueError, match="unconnected: expected"):
        flatten(sys, unconnected="ignore")


MAKERS = {
    "phyfilter_block": lambda **options: phyfilter_block(PhyFilter([20.0]), 2, name="filter", **options),
    "sampled_block": lambda **options: sampled_block(
        PhyFilter([20.0]).sampled(0.01), 2, name="filter", **options
    ),
}


@pytest.mark.filterwarnings("ignore:Unused")
def test_what_the_refusal_says_to_type_works():
    """Each of its two ways out, typed as it stands there."""
    block = lag("lag", "u", "y")
    other = static(lambda t, x, u, params: 2.0 * u[0], "other", inputs="v", outputs="uu")
    named = {"inplist": ["other.v"], "inputs": ["v"], "outlist": ["lag.y"], "outputs": ["y"]}
    with pytest.raises(ValueError, match=r"nothing drives lag\.u\[0\]|nothing drives lag\.u") as refusal:
        flatten(ct.interconnect([block, other], **named))
    assert 'connections=[["lag.u", "block.output"]]' in str(refusal.value)
    assert (
        flatten(ct.interconnect([block, other], connections=[["lag.u", "other.uu"]], **named)).undriven == ()
    )
    assert flatten(ct.interconnect([block, other], **named), unconnected="zero").undriven == ("lag.u",)


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.filterwarnings("ignore:Unused")
def test_a_learned_model_may_be_left_out(maker):
    signals = [f"filter.{letter}[{i}]" for letter in "xg" for i in (0, 1)]
    named = {"inplist": signals, "inputs": 4, "outlist": ["filter.f_hat[0]"], "outputs": ["f_hat"]}
    left = flatten(ct.interconnect([MAKERS[maker]()], **named))
    without = flatten(ct.interconnect([MAKERS[maker](f_theta=False)], **named))
    assert left.undriven == without.undriven == ()
    u = np.array([0.3, -0.2, 1.0, 2.0])
    runs = [simulate(flat, [0.0, 0.1, 0.2], [*u]).outputs for flat in (left, without)]
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-14)
    with pytest.raises(ValueError, match=r"nothing drives filter\.f_theta\[1\]"):  # half of it is a slip
        flatten(
            ct.interconnect(
                [MAKERS[maker]()], **named | {"inplist": [*signals, "filter.f_theta[0]"], "inputs": 5}
            )
        )


@pytest.mark.filterwarnings("ignore:Unused")
def test_a_learned_model_left_out_in_a_sampled_diagram():
    parts = [phyfilter_block(PhyFilter([20.0]).sampled(0.01), 1, name="filter")]
    ends = {
        "inplist": ["filter.x[0]", "filter.g[0]"],
        "inputs": 2,
        "outlist": ["filter.f_hat[0]"],
        "outputs": 1,
    }
    computer = sampled_block(ct.interconnect(parts, **ends, name="computer"))
    assert flatten(computer).undriven == ()


@pytest.mark.filterwarnings("ignore:Unused")
def test_a_margin_says_what_it_took_as_zero():
    plant = ct.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]], inputs=["v", "d"], outputs="y", name="plant")
    add = ct.summing_junction(inputs=["u", "r"], output="v", name="add")
    law = ct.ss([], [], [], [[-2.0]], inputs="y", outputs="u", name="law")
    held = sampled_block(ct.ss([], [], [], [[-2.0]], 0.01, inputs="y", outputs="u", name="law"))
    for controller in (law, held):
        about = margins(ct.interconnect([plant, add, controller], inputs="r", outputs="y"), at="law.u").about
        assert "nothing drives plant.d, taken as 0" in about


def test_unconnected_input_of_a_diagram_inside():
    """The border of the inner diagram is connected to its block; nothing is connected to the border."""
    inner = ct.interconnect([lag("lag", "u", "y")], inputs="u", outputs="y", name="inner")
    with pytest.warns(UserWarning, match="Unused"):
        outer = ct.interconnect([inner, lag("other", "v", "w")], inputs="v", outputs=["y", "w"], name="outer")
    with pytest.raises(ValueError, match=r"nothing drives inner\.lag\.u"):
        flatten(outer)


def test_two_outputs_of_one_name():
    """python-control adds them up where it wires by name; with connections= the same sum is meant."""
    parts = [lag("a", "u", "y"), lag("b", "u", "y"), lag("c", "y", "z")]
    with pytest.raises(ValueError, match=r"c\.y is driven by a\.y and by b\.y, all called 'y'"):
        flatten(ct.interconnect(parts, inputs="u", outputs="z", name="sum"))
    with pytest.raises(ValueError, match=r"output y is driven by a\.y and by b\.y"):
        flatten(ct.interconnect(parts[:2], inputs="u", outputs="y", name="sum"))
    meant = ct.interconnect(parts, connections=[["c.y", "a.y", "b.y"]], inplist=[["a.u", "b.u"]], inputs="u",
                            outlist=["c.z"], outputs="z", name="sum")  # fmt: skip
    assert np.asarray(flatten(meant).dynamics(0, [1.0, 2.0, 0.0], [0.0], [], [])).ravel().tolist() == [
        -1,
        -2,
        3,
    ]


def test_input_of_the_diagram_and_output_of_one_name():
    with pytest.raises(ValueError, match=r"b\.y is driven by a\.y and by the input y"):
        flatten(
            ct.interconnect(
                [lag("a", "u", "y"), lag("b", "y", "z")], inputs=["u", "y"], outputs="z", name="d"
            )
        )
    # Under another name it is a disturbance that is meant.
    sys = ct.interconnect([lag("a", "u", "y"), lag("b", "y", "z")], inplist=["a.u", "b.y"], inputs=["u", "d"],
                          outputs="z", name="d")  # fmt: skip
    assert np.asarray(flatten(sys).dynamics(0, [1.0, 0.0], [0.0, 5.0], [], [])).ravel().tolist() == [
        -1.0,
        6.0,
    ]


def test_one_block_twice():
    """python-control wires the second one's signals to the first, with gain 2; it warns, flatten refuses."""
    a = lag("a", "u", "y")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        sys = ct.interconnect([a, a, lag("c", "y", "z")], inputs="u", outputs="z", name="d")
    with pytest.raises(ValueError, match=r"driven by .* \(twice\).*its own name="):
        flatten(sys)


def test_names_that_clash():
    parts = [lag("a", "u", "y"), lag("a", "y", "z"), lag("a_1", "z", "w")]
    with pytest.warns(UserWarning, match="duplicate name"):
        sys = ct.InterconnectedSystem(parts, connections=[[(1, 0), (0, 0)], [(2, 0), (1, 0)]], inplist=[(0, 0)],
                                      outlist=[(2, 0)], inputs="u", outputs="w", name="d")  # fmt: skip
    with pytest.raises(ValueError, match="give each block its own name="):
        flatten(sys)
