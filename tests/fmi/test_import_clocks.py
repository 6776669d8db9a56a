"""Clocks and discrete inputs of imported FMUs: ticks where FMI has them, by an FMU that refuses all others."""

import numpy as np
import pytest
from foreign_clocks import clocks_fmu

import phyfilter_ctl as pf
from phyfilter_ctl.cli import main
from phyfilter_ctl.fmi import Fmu, FmuError, Master, System, cosimulate, describe, import_fmu

# By hand from the intervals in foreign/clocks.c; `rings` goes with every fifth tick.
HAND = [0.05, 0.5]
TICKS = {
    "fast": np.arange(11) / 10,
    "slow": [0.2, 0.4, 0.7],
    "soon": [0.25],
    "hand": HAND,
    "rings": [0.2, 0.5, 0.8],
}
EXACT = 1e-12
TIMES = np.linspace(0.0, 1.0, 11)


def ticks_of(pairs):
    """By clock."""
    found = {}
    for t, name in pairs:
        found.setdefault(name, []).append(t)
    return found


def assert_ticked(found, prefix=""):
    assert {name.removeprefix(prefix) for name in found} == set(TICKS)
    for name, times in TICKS.items():
        np.testing.assert_allclose(found[prefix + name], times, rtol=0.0, atol=EXACT, err_msg=name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("clocks")


def stepped(t):
    return 0.0 if t < 0.35 else 3.0


@pytest.mark.parametrize("kind", ["cs", pytest.param("se", marks=pytest.mark.slow)])
@pytest.mark.parametrize("points", [11, pytest.param(5, marks=pytest.mark.slow)])
def test_ticks_at_and_between_communication_points(folder, kind, points):
    times = np.linspace(0.0, 1.0, points)
    response = cosimulate(
        {"fmu": Fmu(clocks_fmu(folder, kind), clocks={"hand": HAND})}, times,
        inputs={"fmu.u": 2.0, "fmu.sample": lambda t: t, "fmu.level": stepped},
    )  # fmt: skip
    assert response.success, response.message
    assert_ticked(response.ticks, "fmu.")
    y = dict(zip(response.output_labels, np.asarray(response.outputs), strict=True))
    # A tick at a communication point sees the inputs there, one in between those held.
    last = np.floor(10 * times + 1e-9) / 10
    held = np.where(np.isclose(last, times), times, times - times[1])
    held[0] = 0.0
    np.testing.assert_allclose(y["fmu.held"], held, rtol=0.0, atol=EXACT)
    assert y["fmu.ticks[0]"].tolist() == (np.floor(10 * times + 1e-9) + 1).tolist()
    if kind == "cs":
        np.testing.assert_allclose(y["fmu.x"], 2.0 * times, rtol=0.0, atol=EXACT)
        assert y["fmu.seen"].tolist() == (times > 0.35).astype(float).tolist()


@pytest.mark.parametrize("isolated", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_model_exchange_ticks_and_takes_discrete_inputs_in_events(folder, isolated):
    """The FMU refuses times beyond a tick, and discrete inputs outside of Event Mode."""
    block = import_fmu(
        Fmu(clocks_fmu(folder, "me"), parameters={"jump_at": 0.33}, isolated=isolated, clocks={"hand": HAND})
    )
    assert block.input_labels == ["u", "sample", "level"]
    times = np.linspace(0.0, 1.0, 21)
    level = np.where(times < 0.35, 0.0, 3.0)
    inputs = np.array([np.full(21, 2.0), times, level])
    response = pf.simulate(block, times, inputs, interpolation="hold")
    assert response.success, response.message
    assert_ticked(ticks_of(block.ticks))
    x, held, seen, fast = response.outputs[:4]
    np.testing.assert_allclose(x, 2.0 * times + (times > 0.33), rtol=0.0, atol=EXACT)
    # A tick at the instant of a jump sees what was held until then.
    before = np.maximum(np.floor(10 * times + 1e-9) / 10 - 0.05, 0.0)
    np.testing.assert_allclose(held, before, rtol=0.0, atol=EXACT)
    assert seen.tolist() == (times > 0.34).astype(float).tolist()
    assert fast.tolist() == (np.floor(10 * times + 1e-9) + 1).tolist()
    assert np.array_equal(pf.simulate(block, times, inputs, interpolation="hold").outputs, response.outputs)


@pytest.mark.slow
def test_python_control_is_told_what_it_cannot_run(folder):
    block = import_fmu(clocks_fmu(folder, "me"), kind="me")
    with pytest.raises(FmuError, match="time event at t = 0, before t = 0"):
        block.dynamics(0.0, [0.0], [1.0, 0.0, 0.0])
    free = import_fmu(clocks_fmu(folder, "me"), kind="me", events="ignore")
    assert free.dynamics(0.0, [0.0], [1.5, 0.0, 0.0]) == [1.5]


def test_what_clocks_cannot_be(folder):
    clocks = {clock.name: clock for clock in describe(clocks_fmu(folder, own=True)).clocks}
    assert clocks["slow"].shift == 0.2
    assert (clocks["fast"].interval, clocks["soon"].interval) == (0.1, None)
    path = clocks_fmu(folder, "cs")
    for given, message in (
        ({"fast": 0.2}, "'fast' has a constant interval"),
        ({"hand": 0.2}, "hand is triggered: expected the times"),
        ({"rings": [0.2]}, "'rings' is no input clock; there are fast, slow, soon, hand"),
        ({"hand": [0.2, 0.1]}, "clocks: hand: expected increasing times"),
    ):
        with pytest.raises(ValueError, match=message):
            import_fmu(Fmu(path, clocks=given), step=0.1)
    rigid = clocks_fmu(folder, "cs", variable_step=False)
    with pytest.raises(FmuError, match=r"hand: ticks at t = 0.05, inside a communication step.*all equal"):
        cosimulate({"fmu": Fmu(rigid, clocks={"hand": HAND})}, TIMES)


@pytest.mark.slow
def test_an_interval_of_the_importers(folder):
    for kind in ("cs", "se"):
        path = clocks_fmu(folder, kind, own=True)
        response = cosimulate({"fmu": Fmu(path, clocks={"own": 0.3})}, TIMES)
        np.testing.assert_allclose(response.ticks["fmu.own"], np.arange(4) * 0.3, rtol=0.0, atol=EXACT)
        with pytest.raises(FmuError, match="own: nobody has told the interval; give it by clocks="):
            cosimulate({"fmu": path}, timepts=TIMES)


def test_an_event_inside_a_step_is_handled_there(folder):
    """Early return at 0.33, Event Mode, and on; later steps see the jump."""
    path = clocks_fmu(folder, "cs")
    response = cosimulate(
        {"fmu": path}, timepts=TIMES, inputs={"fmu.u": 1.0}, parameters={"fmu.jump_at": 0.33}
    )
    np.testing.assert_allclose(response.outputs[0], TIMES + (TIMES > 0.33), rtol=0.0, atol=EXACT)


@pytest.mark.slow
def test_from_the_command_line(folder, capsys):
    assert (
        main(
            [
                "fmu",
                "run",
                str(clocks_fmu(folder, "se")),
                "--step",
                "0.1",
                "--clock",
                "hand=0.05,0.5",
                "--out",
                "-",
            ]
        )
        == 0
    )
    rows = [line.split(",") for line in capsys.readouterr().out.splitlines()]
    hands = rows[0].index("ticks[3]")
    assert [float(row[hands]) for row in rows[1:]] == [0.0, *[1.0] * 4, *[2.0] * 6]


@pytest.mark.slow
def test_steps_by_the_error_take_ticks_back(folder):
    """The FMU answers Error to a tick that is made twice or left out."""
    response = cosimulate(
        {"fmu": Fmu(clocks_fmu(folder, "cs"), clocks={"hand": HAND})}, TIMES, master=Master(tolerance=1e-3),
        inputs={"fmu.u": lambda t: 3.0 * t, "fmu.sample": lambda t: t, "fmu.level": stepped},
        parameters={"fmu.jump_at": 0.33},
    )  # fmt: skip
    assert response.success, response.message
    assert response.rejected > 0
    assert_ticked(response.ticks, "fmu.")
    expected = 1.5 * TIMES**2 + (TIMES > 0.33)
    # Of first order: the error of two halves is their difference to the whole, which each step may make anew.
    allowed = 1e-3 * (1.0 + expected[-1]) * response.steps
    assert np.max(np.abs(np.asarray(response.outputs[0]) - expected)) < allowed < 0.2


@pytest.mark.slow
def test_discrete_inputs_of_a_model_integrated_here(folder):
    """Taken in at the communication point where they change, seen in the result there."""
    response = cosimulate(
        {"fmu": Fmu(clocks_fmu(folder, "me"), clocks={"hand": HAND})}, TIMES,
        inputs={"fmu.u": 2.0, "fmu.level": stepped},
    )  # fmt: skip
    assert response.success, response.message
    assert_ticked(response.ticks, "fmu.")
    y = dict(zip(response.output_labels, np.asarray(response.outputs), strict=True))
    assert y["fmu.seen"].tolist() == (TIMES > 0.35).astype(float).tolist()
    np.testing.assert_allclose(y["fmu.x"], 2.0 * TIMES, rtol=0.0, atol=EXACT)


@pytest.mark.slow
@pytest.mark.parametrize("isolated", [False, True])
def test_what_an_fmu_tells_inside_its_steps(folder, isolated):
    """It tells of the middle of each step; steps that are taken back leave nothing."""
    path = Fmu(clocks_fmu(folder, "cs"), isolated=isolated)
    given = {"timepts": TIMES, "inputs": {"fmu.u": lambda t: 3.0 * t}}
    response = cosimulate({"fmu": path}, master=Master(intermediate=True), **given)
    told = response.intermediate["fmu"]
    assert told.output_labels == ["x", "held"]
    # Steps end at ticks of clocks too; x runs on a line over each.
    ends = np.unique(
        np.round([0.0, *(t for name in ("fast", "slow", "soon") for t in response.ticks[f"fmu.{name}"])], 9)
    )
    np.testing.assert_allclose(told.time, (ends[1:] + ends[:-1]) / 2, rtol=0.0, atol=1e-9)
    expected = np.interp(told.time, TIMES, np.asarray(response.outputs)[0])
    np.testing.assert_allclose(told.outputs[0], expected, rtol=0.0, atol=EXACT)
    assert np.array_equal(cosimulate({"fmu": path}, **given).outputs, response.outputs)
    controlled = cosimulate({"fmu": path}, master=Master(tolerance=1e-3, intermediate=True), **given)
    assert controlled.rejected > 0
    assert np.all(np.diff(controlled.intermediate["fmu"].time) > 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cs", "me"])
def test_discrete_inputs_from_a_file_are_held(folder, tmp_path, capsys, kind):
    """Rows further apart than steps: an integer has no values in between."""
    given = tmp_path / "given.csv"
    given.write_text("time,level,u\n0,0,1\n0.3,2,1\n0.9,7,1\n")
    path = str(clocks_fmu(folder, kind))
    assert (
        main(["fmu", "run", path, "--kind", kind, "--step", "0.1", "--input", str(given), "--out", "-"]) == 0
    )
    rows = [line.split(",") for line in capsys.readouterr().out.splitlines()]
    seen = [float(row[rows[0].index("seen")]) for row in rows[1:]]
    assert seen == [0.0] * 3 + [1.0] * 6 + [2.0] * 2
    x = [float(row[1]) for row in rows[1:]]
    np.testing.assert_allclose(x, TIMES, rtol=0.0, atol=EXACT)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cs", "me", "se"])
def test_a_clock_ticks_with_another_ones(folder, kind):
    """`rings` of one triggers `hand` of the next: at the communication point, and heard there after a step."""
    parts = {"a": Fmu(clocks_fmu(folder, "cs"), clocks={"hand": HAND}), "b": clocks_fmu(folder, kind)}
    wired = System(parts, [("b.hand", "a.rings")])
    response = cosimulate(wired, TIMES, inputs={"a.u": lambda t: 3.0 * t})
    assert response.success, response.message
    np.testing.assert_allclose(response.ticks["a.rings"], TICKS["rings"], rtol=0.0, atol=EXACT)
    np.testing.assert_allclose(response.ticks["b.hand"], TICKS["rings"], rtol=0.0, atol=EXACT)
    hands = response.outputs["b.ticks[3]"]
    assert hands.tolist() == [0.0] * 2 + [1.0] * 3 + [2.0] * 3 + [3.0] * 3
    with pytest.raises(ValueError, match=r"'b\.hand' from 'a\.x': expected a triggered input clock"):
        cosimulate(System(parts, [("b.hand", "a.x")]), TIMES)
