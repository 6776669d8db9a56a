"""Periodic clocks of exported FMUs: ticked by a host, the same bits as time events; refused where they do not tick."""

import ctypes
import xml.etree.ElementTree as ET

import fmpy
import numpy as np
import pytest
from exported_fmus import (
    FILTER,
    PERIOD,
    Instance,
    described,
    exported,
    oscillator,
    quick_compiler,
    refused,
    unpacked,
)
from fmpy import fmi3
from fmpy.validation import validate_fmu

from phyfilter_ctl.codegen.filter_cmodel import filter_model
from phyfilter_ctl.fmi import FmuPorts, check, cosimulate, import_fmu
from phyfilter_ctl.fmi.description import fmu_interface
from phyfilter_ctl.fmi.export import export_fmu
from phyfilter_ctl.simulation import simulate

pytestmark = pytest.mark.slow
ERROR = 3
LOOP = {"clock.law": 0.02, "clock.observer": 0.005}


def clocked():
    flags = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror")
    return exported("loop", "3.0", ports=FmuPorts(clocks=True), compiler=(*quick_compiler(), *flags))


def tick(fmu, t, periods):
    """Set the clocks that tick at t; how many."""
    due = [name for name, period in periods.items() if t > 0.0 and round(t / period, 6) % 1.0 == 0.0]
    if due:
        fmu.fmu.setClock([fmu.references(name)[0][0] for name in due], [True] * len(due))
    return len(due)


def everything(fmu):
    """Outputs and states of the sampled blocks."""
    names = [v.name for v in fmu.description.modelVariables if v.causality in ("output", "local")]
    return fmu.get(*(name for name in names if not name.startswith(("der(", "condition."))))


def exchange(path, periods, steps=120, h=0.001):
    """Euler's method in steps of h with events at the instants: by clocks, or by the times that the FMU tells."""
    rows, events = [], 0
    with Instance(path, "me") as fmu:
        fmu.enter().set(goal=1.0, f_theta=0.1)
        fmu.fmu.exitInitializationMode()
        upcoming = fmu.update()
        fmu.fmu.enterContinuousTimeMode()
        n = len([v for v in fmu.description.modelVariables if v.derivative])
        x, dx = (ctypes.c_double * n)(), (ctypes.c_double * n)()
        for k in range(1, steps + 1):
            fmu.fmu.getContinuousStates(x, n)
            fmu.fmu.getContinuousStateDerivatives(dx, n)
            fmu.fmu.setTime(k * h)
            fmu.fmu.setContinuousStates((ctypes.c_double * n)(*(np.array(x) + h * np.array(dx))), n)
            fmu.set(goal=np.sin(0.1 * k))
            due = upcoming is not None and upcoming <= k * h + 1e-9
            if periods or due:
                fmu.fmu.enterEventMode()
                events += tick(fmu, k * h, periods)
                rows.append(everything(fmu))
                upcoming = fmu.update()
                fmu.fmu.enterContinuousTimeMode()
            if k % 5 == 0:
                rows.append(everything(fmu))
    return rows, events, upcoming


def test_ticks_in_model_exchange_are_the_time_events_to_the_bit():
    plain, _, upcoming = exchange(exported("loop", "3.0"), {})
    ticked, events, none = exchange(clocked(), LOOP)
    assert events == 24 + 6
    assert upcoming is not None
    assert none is None
    # At an instant, before updateDiscreteStates: the old values without clocks, the new ones while they tick.
    assert np.array_equal(plain[1::2], ticked[5::6])
    assert np.array_equal(ticked[4::6], ticked[5::6])
    assert not np.array_equal(plain[0::2], plain[1::2])


def test_ticks_in_cosimulation_are_the_time_events_to_the_bit():
    runs = []
    for clocks in (False, True):
        path = clocked() if clocks else exported("loop", "3.0")
        with Instance(path, event_mode=True) as fmu:
            fmu.start(goal=1.0, f_theta=0.1)
            rows = []
            for k in range(1, 41):
                fmu.step(0.005, goal=np.sin(0.5 * k))
                fmu.fmu.enterEventMode()
                fmu.set(goal=np.cos(0.5 * k))
                if clocks:
                    assert tick(fmu, fmu.time, LOOP) == 1 + (k % 4 == 0)
                fmu.update()
                rows.append(everything(fmu))
                fmu.fmu.enterStepMode()
            runs.append(rows)
    assert np.array_equal(*runs)


def test_importers_without_clocks_run_it_all_the_same():
    path = clocked()
    for kind in ("CoSimulation", "ModelExchange"):
        options = {
            "fmi_type": kind,
            "stop_time": 0.2,
            "output_interval": 0.005,
            "start_values": {"goal": 1.0},
        }
        runs = [
            fmpy.simulate_fmu(str(p), output=["s", "v", "f_hat"], **options)
            for p in (path, exported("loop", "3.0"))
        ]
        assert np.array_equal(*runs)
    assert validate_fmu(str(path)) == []
    assert check(path).errors == ()


def test_description_tells_intervals_and_what_belongs_to_which_clock():
    path = clocked()
    variables = {v.name: v for v in described(path).modelVariables}
    clocks = {name: v for name, v in variables.items() if v.type == "Clock"}
    root = ET.parse(unpacked(path) / "modelDescription.xml").getroot()
    told = {entry.get("name"): entry.attrib for entry in root.iter("Clock")}
    for key in ("intervalDecimal", "shiftDecimal"):
        assert {name: float(entry[key]) for name, entry in told.items()} == LOOP
    for key in ("intervalCounter", "shiftCounter"):
        assert {name: int(entry[key]) / int(entry["resolution"]) for name, entry in told.items()} == LOOP
    assert {entry["intervalVariability"] for entry in told.values()} == {"constant"}
    owned = {name: v.clocks for name, v in variables.items() if name.startswith("observer.w")}
    assert owned
    assert all(entry == [clocks["clock.observer"]] for entry in owned.values())
    assert variables["f_hat"].clocks is None
    with Instance(path) as fmu:
        fmu.enter()
        refs = [clocks[name].valueReference for name in LOOP]
        c_refs = (fmi3.fmi3ValueReference * 2)(*refs)
        decimal, shift, kinds = (ctypes.c_double * 2)(), (ctypes.c_double * 2)(), (ctypes.c_int * 2)()
        fmu.fmu.fmi3GetIntervalDecimal(fmu.fmu.component, c_refs, 2, decimal, kinds)
        fmu.fmu.fmi3GetShiftDecimal(fmu.fmu.component, c_refs, 2, shift)
        counters, resolutions = (ctypes.c_uint64 * 2)(), (ctypes.c_uint64 * 2)()
        fmu.fmu.fmi3GetIntervalFraction(fmu.fmu.component, c_refs, 2, counters, resolutions, kinds)
        assert list(decimal) == list(shift) == list(LOOP.values())
        assert [c / r for c, r in zip(counters, resolutions, strict=True)] == list(LOOP.values())
        assert list(kinds) == [2, 2]  # fmi3IntervalChanged: known from now on


def test_ticks_that_are_none_are_refused_and_change_nothing():
    path = clocked()
    with Instance(path, event_mode=True) as fmu:
        law, observer, v = (fmu.references(name)[0][0] for name in ("clock.law", "clock.observer", "v"))
        assert refused(fmu.fmu.setClock, [observer], [True]) == ERROR  # not in Event Mode
        fmu.start(goal=1.0)
        fmu.step(0.003)
        fmu.fmu.enterEventMode()
        assert refused(fmu.fmu.setClock, [v], [True]) == ERROR
        assert refused(fmu.get, "clock.law") == ERROR
        assert refused(fmu.fmu.setClock, [observer], [True]) == ERROR
        assert (
            "'clock.observer' ticks once at start + k * 0.005 s, k >= 1, such as 0.005 s" in fmu.messages[-1]
        )
        fmu.update()
        fmu.fmu.enterStepMode()
        fmu.step(0.017)
        fmu.fmu.enterEventMode()
        fmu.fmu.setClock([observer], [True])
        assert fmu.fmu.getClock([law, observer]) == [False, True]
        assert refused(fmu.fmu.updateDiscreteStates) == ERROR
        assert "'clock.law' ticks at this instant too" in fmu.messages[-1]
        saved = fmu.save()
        fmu.fmu.setClock([law], [True])
        expected = everything(fmu)
        fmu.update()
        assert fmu.fmu.getClock([law, observer]) == [False, False]
        assert refused(fmu.fmu.setClock, [law], [True]) == ERROR  # once only
        fmu.restore(saved)
        assert fmu.fmu.getClock([law, observer]) == [False, True]
        fmu.fmu.setClock([law], [True])
        fmu.update()
        assert np.array_equal(everything(fmu), expected)
        fmu.free(saved)
    with Instance(path, "me") as fmu:
        fmu.start(goal=1.0)
        fmu.fmu.setTime(0.005)
        fmu.fmu.enterEventMode()
        fmu.fmu.setClock([observer], [True])
        fmu.fmu.setTime(1e9)  # a tick is of its instant: nothing is caught up with
        assert fmu.fmu.getClock([observer]) == [False]
        assert refused(fmu.fmu.setClock, [observer], [True]) == ERROR
    with Instance(path, "me") as fmu:
        fmu.start(goal=1.0)
        fmu.fmu.enterEventMode()
        fmu.fmu.setClock([observer], [False])
        fmu.update()
        fmu.fmu.enterContinuousTimeMode()
        fmu.fmu.setTime(0.006)
        fmu.fmu.enterEventMode()
        assert refused(fmu.fmu.updateDiscreteStates) == ERROR
        assert "a clock that was to tick at 0.005 s did not" in fmu.messages[-1]


def test_clocks_that_there_cannot_be(tmp_path):
    sampled = FILTER.sampled(PERIOD)
    for system, options, message in (
        (sampled, {"rate": "fixed", "fmi": "2.0"}, "FMI 3.0"),
        (sampled, {}, "rate='fixed'"),
        (oscillator(), {}, "instants of its own"),
    ):
        with pytest.raises(ValueError, match=message):
            export_fmu(system, tmp_path / "a.fmu", ports=FmuPorts(clocks=True), **options)
    model = filter_model(sampled, 2, name="fixed", rate="fixed")
    variables = fmu_interface(model, clocks=True).variables
    clock = next(i for i, v in enumerate(variables) if v.kind == "clock")
    assert [v.clock for v in variables if v.kind == "sampled"] == [clock]


def test_the_importer_ticks_them_too():
    """In co-simulation the same bits as by time events; in model exchange to the integrator's rounding."""
    times = np.linspace(0.0, 0.2, 41)
    plain, ticked = (
        cosimulate({"f": path}, timepts=times, inputs={"f.goal": 1.0})
        for path in (exported("loop", "3.0"), clocked())
    )
    assert plain.ticks == {}
    for name, period in LOOP.items():
        expected = period * np.arange(1, round(0.2 / period) + 1)
        np.testing.assert_allclose(ticked.ticks[f"f.{name}"], expected, rtol=0.0, atol=1e-12)
    assert np.array_equal(plain.outputs, ticked.outputs)
    block = import_fmu(clocked(), kind="me")
    goal = np.where([[label == "goal"] for label in block.input_labels], np.ones(len(times)), 0.0)
    response = simulate(block, times, goal)
    np.testing.assert_allclose(response.outputs, ticked.outputs, rtol=0.0, atol=1e-9)
