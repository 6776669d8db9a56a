"""Designs in messages: any that may be shown is answered, any other is refused by the name of its field."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from designer_messages import answered, message_of, refused
from hypothesis import example, given, settings
from hypothesis import strategies as st

from phyfilter_ctl import PhyFilter, place_poles
from phyfilter_ctl.app.checking import Fields, MessageError, shown
from phyfilter_ctl.app.designs import Design, read_design
from phyfilter_ctl.app.handling import Session, handle

# Products of up to eight poles, each rounded.
SAME_POLYNOMIAL = 1e-12


@st.composite
def designs(draw) -> dict:
    """Order 1 to 8, poles over five decades, some of them repeated, every kind of numerator."""
    order = draw(st.integers(1, 8))
    poles: list[complex] = []
    last: list[complex] = []
    while len(poles) < order:
        size = 10.0 ** draw(st.floats(-2.0, 4.0))
        damping = draw(st.floats(0.01, 1.0))
        if last and len(last) <= order - len(poles) and draw(st.booleans()):
            pass  # once more
        elif order - len(poles) == 1 or draw(st.booleans()):
            last = [complex(-size)]
        else:
            pole = size * complex(-damping, np.sqrt(1.0 - damping**2))
            last = [pole, pole.conjugate()] if pole.imag > 0.0 else [pole]
        poles += last
    kind = draw(st.sampled_from(["lowpass", "type", "zeros", "b"]))
    numerator: dict = {"kind": kind}
    if kind == "type":
        numerator["type"] = draw(st.integers(1, order))
    elif kind == "zeros":
        zeros = [-(10.0 ** draw(st.floats(-1.0, 3.0))) for _ in range(draw(st.integers(0, order - 1)))]
        numerator |= {"zeros": [[z, 0.0] for z in zeros], "gain": draw(st.floats(-1e3, 1e3))}
    elif kind == "b":
        numerator["b"] = draw(st.lists(st.floats(-1e6, 1e6), min_size=order, max_size=order))
    return message_of(
        poles,
        numerator=numerator,
        dt=10.0 ** draw(st.floats(-4.0, -1.0)),
        method=draw(st.sampled_from(["exact", "tustin", "euler"])),
    )


def with_b(poles: list[complex], b: list[float], dt: float = 0.002) -> dict:
    return message_of(poles, numerator={"kind": "b", "b": b}, dt=dt)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(designs())
@example(with_b([-20.0, -15 + 8j, -15 - 8j], [1.1085011130014349e-88, 1.0, 1.2912435758480616e-266], dt=0.1))
@example(with_b([-1806.0, -0.1256, -1.0], [-0.0, 976454.5, -2.2250738585072014e-308]))
@example(with_b([-1.0], [5e-324]))
@example(with_b([-1.0], [0.0]))
@example(message_of([-0.5 + 99990j, -0.5 - 99990j] * 4, dt=1.0))
def test_every_design_is_answered(message):
    session = Session()
    reply = answered(session, "design", design=message)  # through JSON without NaN
    filter = reply["filter"]
    assert len(filter["a"]) == len(message["poles"])
    expected = np.real(np.poly([complex(*p) for p in message["poles"]]))[:0:-1]
    np.testing.assert_allclose(filter["a"], expected, rtol=SAME_POLYNOMIAL)
    assert filter["a"] == session.filter.a.tolist()
    keys = {entry["key"] for entry in reply["numbers"]}
    assert keys >= {
        "bandwidth", "noise_gain", "bound", "ratio_low", "ratio_high", "delay_margin", "phase_margin",
        "euler_dt", "settling",
    }  # fmt: skip
    # Where a figure is missing its note says why.
    assert all(entry["value"] is not None or entry.get("note") for entry in reply["numbers"])


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(designs())
def test_python_text_rebuilds_the_filter(message):
    session = Session()
    text = answered(session, "python", design=message)["text"]
    found: dict = {}
    exec(text, found)
    filter = read_design(Fields({"design": message})).filter
    np.testing.assert_array_equal(found["filter"].a, filter.a)
    np.testing.assert_array_equal(found["filter"].b, filter.b)
    np.testing.assert_array_equal(found["filter"].poles, filter.poles)
    if "sampled" in found:
        assert found["sampled"].dt == message["sampling"]["dt"]
        assert found["sampled"].sampling.method == message["sampling"]["method"]
    else:
        assert message["sampling"]["method"] == "euler"


@settings(max_examples=30, deadline=None)
@given(designs())
def test_designs_survive_their_own_json(message):
    design = read_design(Fields({"design": message}))
    again = read_design(Fields({"design": design.as_json()}))
    assert again.filter == design.filter
    assert again.as_json() == design.as_json()


@pytest.mark.parametrize("k", [1, 2, 3])
def test_type_is_that_of_place_poles(k):
    poles = [-20.0, -15 + 8j, -15 - 8j]
    reply = answered(Session(), "design", design=message_of(poles, numerator={"kind": "type", "type": k}))
    expected = place_poles(poles, type=k)
    assert reply["filter"]["b"] == expected.b.tolist()
    assert reply["filter"]["type"] == k


def changed(path: str, value: object) -> dict:
    """A good design with one entry replaced, or taken out by ``...``."""
    design = copy.deepcopy(message_of([-20.0, -15 + 8j, -15 - 8j]))
    *inner, last = path.split(".")
    place: dict = design
    for key in inner:
        place = place[int(key) if key.isdigit() else key]
    if value is ...:
        del place[last]
    else:
        place[int(last) if last.isdigit() else last] = value
    return design


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("path", "value", "where"),
    [
        ("poles", [], "design.poles"),
        ("poles", [[-1.0, 0.0]] * 9, "design.poles"),
        ("poles", [[-1.0, 0.0]] * 1000, "design.poles"),
        ("poles", "many", "design.poles"),
        ("poles", ..., "design.poles"),
        ("poles.0", [-20.0], "design.poles[0]"),
        ("poles.0", -20.0, "design.poles[0]"),
        ("poles.0", [20.0, 0.0], "design.poles[0]"),
        ("poles.0", [0.0, 0.0], "design.poles[0]"),
        ("poles.0", [-1e-4, 0.0], "design.poles[0]"),
        ("poles.0", [-1e6, 0.0], "design.poles[0]"),
        ("poles.0", [NAN, 0.0], "design.poles[0]"),
        ("poles.0", [-INF, 0.0], "design.poles[0]"),
        ("poles.0", [-(10**400), 0], "design.poles[0]"),
        ("poles.0", [True, 0.0], "design.poles[0]"),
        ("poles.0", ["-1", 0.0], "design.poles[0]"),
        ("poles.0", [-20.0, 1.0], "design.poles"),  # without its conjugate
        ("numerator.kind", "elliptic", "design.numerator.kind"),
        ("numerator.kind", ["b"], "design.numerator.kind"),
        ("numerator", {"kind": "type", "type": 0}, "design.numerator.type"),
        ("numerator", {"kind": "type", "type": 4}, "design.numerator.type"),
        ("numerator", {"kind": "type", "type": 2.0}, "design.numerator.type"),
        ("numerator", {"kind": "type", "type": True}, "design.numerator.type"),
        ("numerator", {"kind": "lowpass", "b": []}, "design.numerator"),
        ("numerator", {"kind": "b", "b": [1.0]}, "design.numerator.b"),
        ("numerator", {"kind": "b", "b": [1.0, NAN, 0.0]}, "design.numerator.b[1]"),
        ("numerator", {"kind": "zeros", "zeros": [[0.0, 0.0]] * 3, "gain": 1.0}, "design.numerator.zeros"),
        ("numerator", {"kind": "zeros", "zeros": [[0.0, 1.0]], "gain": 1.0}, "design.numerator.zeros"),
        ("numerator", {"kind": "zeros", "zeros": []}, "design.numerator.gain"),
        ("sampling.dt", 0.0, "design.sampling.dt"),
        ("sampling.dt", 2.0, "design.sampling.dt"),
        ("sampling.dt", None, "design.sampling.dt"),
        ("sampling.method", "zoh", "design.sampling.method"),
        ("sampling", ..., "design.sampling"),
        ("assume.slope", -1.0, "design.assume.slope"),
        ("assume.ratio", 0.0, "design.assume.ratio"),
        ("assume.lag", 100.0, "design.assume.lag"),
        ("assume.delay", NAN, "design.assume.delay"),
        ("assume.unit", "x" * 201, "design.assume.unit"),
        ("assume.unit", "\ud800", "design.assume.unit"),
        ("assume.mass", 1.0, "design.assume"),
        ("limits", 3, "design.limits"),
        ("limits", {"F": [[[[[[1.0]]]]]]}, "design.limits.F[0][0][0][0]"),
        ("limits", {"F": list(range(100))}, "design.limits.F[62]"),
        ("limits", {"F": INF}, "design.limits.F"),
        ("limits", {"x" * 50: 1.0}, "design.limits"),
        ("colour", "red", "design"),
    ],
)
def test_refusals_name_the_field(path, value, where):
    reply = handle(Session(), {"id": 1, "op": "design", "design": changed(path, value)})
    assert not reply["ok"]
    assert reply["where"] == where
    assert isinstance(reply["error"], str)
    assert reply["error"].startswith(f"{where}: ")
    assert len(reply["error"]) < 500


def test_null_takes_the_usual_value():
    design = message_of([-20.0]) | {"assume": None, "limits": None, "numerator": None}
    assert answered(Session(), "design", design=design)["filter"]["type"] == 1


@pytest.mark.parametrize(
    "message",
    [
        None,
        [],
        "hello",
        7,
        {},
        {"id": 1},
        {"op": "hello"},
        {"id": "1", "op": "hello"},
        {"id": 1.5, "op": "hello"},
        {"id": True, "op": "hello"},
        {"id": -1, "op": "hello"},
        {"id": 10**400, "op": "hello"},
        {"id": 1, "op": "__class__"},
        {"id": 1, "op": ["hello"]},
        {"id": 1, "op": "hello", "more": 1},
        {"id": 1, "op": "design", "design": []},
        {1: 2, "id": 1, "op": "hello"},
    ],
)
def test_no_message_raises(message):
    reply = handle(Session(), message)
    assert reply["ok"] is False
    assert isinstance(reply["error"], str)


def test_deep_nesting_is_refused():
    deep: object = []
    for _ in range(5000):
        deep = [deep]
    for message in (
        {"id": 1, "op": deep},
        {"id": 1, "op": "design", "design": deep},
        {"id": 1, "op": "design", "design": changed("limits", {"F": deep})},
        {"id": 1, "op": "design", "design": changed("poles.0", deep)},
        {"id": 1, "op": "upload", "name": "a", "size": 1, "at": 0, "data": deep},
    ):
        assert handle(Session(), message)["ok"] is False


def test_an_unforeseen_error_names_its_kind_and_no_path(monkeypatch):
    from phyfilter_ctl.app import answers

    def broken(design: Design) -> dict:
        raise OSError(2, "no such file", "/home/someone/secret")

    monkeypatch.setattr(answers, "answer", broken)
    reply = refused(Session(), "design", design=message_of([-20.0]))
    assert "FileNotFoundError" in reply["error"]
    assert "/" not in reply["error"]


def test_with_filter_refuses_what_is_not_shown():
    for filter in (PhyFilter.from_poles([-1.0] * 9), PhyFilter([1e-5]), PhyFilter([1e6])):
        with pytest.raises(ValueError, match="poles: expected"):
            Session(filter)
    with pytest.raises(ValueError, match="dt: expected"):
        Session(PhyFilter([1.0]).sampled(2.0))


def test_band_pass_of_the_library_keeps_its_zeros():
    from phyfilter_ctl import bandpass

    band = bandpass(4, 4.0, 9.0)
    design = Design().with_filter(band)
    assert design.numerator.kind == "zeros"
    assert design.filter == band


def test_shown_values_are_short():
    assert len(shown("x" * 10_000)) < 60
    assert shown({}) == "an object"
    assert shown(object()) == "a object"
    assert shown(1.5) == "1.5"
    assert str(MessageError("a.b", "wrong")) == "a.b: wrong"
