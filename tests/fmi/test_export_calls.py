"""States, derivatives, parameters, refused calls: what an exported FMU does beyond running."""

import ctypes
from copy import copy

import fmpy
import numpy as np
import pytest
from exported_fmus import (
    FILTER,
    GENERAL,
    MODELS,
    PERIOD,
    Instance,
    described,
    doubles,
    exported,
    refused,
    unpacked,
)
from fmpy import fmi3

import phyfilter_ctl as pf
from tests.cpu_budget import slow_but

VERSIONS = ("2.0", "3.0")
OUTPUTS = {
    "sampled": ["f_hat"], "fixed": ["f_hat"], "continuous": ["f_hat"], "oscillator": ["place", "pull"],
    "loop": ["s", "v", "f_hat"],
}  # fmt: skip
INPUTS = {
    "sampled": ["x", "g", "f_theta"], "fixed": ["x", "g", "f_theta"], "continuous": ["x", "g", "f_theta"],
    "oscillator": ["force"], "loop": ["goal", "f_theta"],
}  # fmt: skip
DISCARD, ERROR = 2, 3
# Central differences of step 1e-6 in double precision.
DIFFERENCES = 1e-7
# Coefficients to matrices in C without libm against numpy's.
RETUNED = 1e-12


def drive(fmu, name, steps, seed=1, h=PERIOD):
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(steps):
        values = {signal: rng.normal(size=fmu.references(signal)[1]) * 0.1 for signal in INPUTS[name]}
        fmu.step(h, **values)
        found.append(fmu.get(*OUTPUTS[name]))
    return np.array(found)


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", slow_but(("sampled",), MODELS))
def test_state_round_trip(name, fmi):
    """The rest of a run from a state put back, and from one that went through bytes, bit for bit."""
    with Instance(exported(name, fmi)) as fmu, Instance(exported(name, fmi)) as other:
        fmu.start()
        other.start()
        drive(fmu, name, 17)
        state, time = fmu.save(), fmu.time
        expected = drive(fmu, name, 20, seed=2)
        fmu.restore(state)
        fmu.time = time
        assert np.array_equal(drive(fmu, name, 20, seed=2), expected)
        bytes_ = fmu.fmu.serializeFMUstate(state) if fmu.two else fmu.fmu.serializeFMUState(state)
        copy = (other.fmu.deSerializeFMUstate if fmu.two else other.fmu.deserializeFMUState)(bytes_)
        other.restore(copy)
        other.time = time
        assert np.array_equal(drive(other, name, 20, seed=2), expected)
        fmu.free(state)
        other.free(copy)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_states_of_others_are_refused(fmi):
    read = "deSerializeFMUstate" if fmi == "2.0" else "deserializeFMUState"
    with Instance(exported("oscillator", fmi)) as fmu, Instance(exported("loop", fmi)) as other:
        fmu.start()
        other.start()
        state = fmu.save()
        data = fmu.fmu.serializeFMUstate(state) if fmu.two else fmu.fmu.serializeFMUState(state)
        damaged = bytearray(data)
        damaged[-3] ^= 1
        for wrong, text in ((bytes(damaged), "damaged"), (data[:-1], "expected"), (data + b"0", "expected")):
            assert refused(getattr(fmu.fmu, read), wrong) == ERROR
            if not fmu.two:
                assert text in fmu.messages[-1]
        assert refused(getattr(other.fmu, read), data) == ERROR
        assert refused(other.restore, state) == ERROR
        assert refused(fmu.restore, ctypes.c_void_p(0)) == ERROR
        assert refused(fmu.restore, ctypes.c_void_p(12345)) == ERROR
        token = bytearray(data)
        token[16] ^= 1
        assert refused(getattr(fmu.fmu, read), bytes(token)) == ERROR
    with Instance(exported("oscillator", fmi), "me") as exchange:
        assert refused(getattr(exchange.fmu, read), data) == ERROR


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", slow_but(("loop", "sampled"), MODELS))
def test_two_instances_do_not_touch_each_other(name, fmi):
    with Instance(exported(name, fmi)) as alone:
        alone.start()
        expected = drive(alone, name, 10)
    with Instance(exported(name, fmi)) as one, Instance(exported(name, fmi)) as two:
        one.start()
        two.start()
        for k in range(10):
            rng = np.random.default_rng(1)
            for _ in range(k):
                [rng.normal(size=one.references(signal)[1]) for signal in INPUTS[name]]
            values = {signal: rng.normal(size=one.references(signal)[1]) * 0.1 for signal in INPUTS[name]}
            one.step(PERIOD, **values)
            drive(two, name, 1, seed=100 + k)
            assert np.array_equal(one.get(*OUTPUTS[name]), expected[k])


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", slow_but(("loop", "sampled"), MODELS))
def test_reset_starts_anew(name, fmi):
    with Instance(exported(name, fmi)) as fmu:
        fmu.start()
        expected = drive(fmu, name, 5)
        fmu.fmu.terminate()
        fmu.fmu.reset()
        fmu.time = 0.0
        fmu.start()
        assert np.array_equal(drive(fmu, name, 5), expected)


# ---- derivatives ----


def jacobian(fmu, unknowns, knowns):
    """By directional derivatives, one column at a time."""
    refs, total = unknowns
    known_refs, n = knowns
    columns = []
    for i in range(n):
        seed = np.eye(n)[i].tolist()
        if fmu.two:
            columns.append(fmu.fmu.getDirectionalDerivative(refs, known_refs, seed))
        else:
            columns.append(fmu.fmu.getDirectionalDerivative(refs, known_refs, seed, total))
    return np.array(columns).T


def names_of(path, *kinds):
    found = []
    for variable in described(path).modelVariables:
        if variable.derivative is not None:
            kind = "derivative"
        elif any(v.derivative is variable for v in described(path).modelVariables):
            kind = "state"
        else:
            kind = variable.causality
        if kind in kinds:
            found.append(variable)
    refs = [variable.valueReference for variable in found]
    return refs, sum(int(np.prod(variable.shape)) for variable in found)


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", slow_but(["loop"], ["continuous", "oscillator", "loop"]))
def test_derivatives_against_finite_differences(name, fmi):
    path = exported(name, fmi)
    unknowns, inputs, states = (
        names_of(path, "derivative", "output"),
        names_of(path, "input"),
        names_of(path, "state"),
    )
    n_x, n_u = states[1], inputs[1]
    rng = np.random.default_rng(4)
    x0, u0 = rng.normal(size=n_x), rng.normal(size=n_u)
    with Instance(path, "me") as fmu:
        fmu.start()

        def evaluate(x, u):
            fmu.fmu.setContinuousStates((ctypes.c_double * n_x)(*x), n_x)
            if fmu.two:
                fmu.fmu.setReal(inputs[0], u.tolist())
                return np.array(fmu.fmu.getReal(unknowns[0]))
            fmu.fmu.setFloat64(inputs[0], u.tolist())
            return np.array(fmu.fmu.getFloat64(unknowns[0], unknowns[1]))

        expected = []
        for i in range(n_x + n_u):
            d = 1e-6 * np.eye(n_x + n_u)[i]
            high, low = evaluate(x0 + d[:n_x], u0 + d[n_x:]), evaluate(x0 - d[:n_x], u0 - d[n_x:])
            expected.append((high - low) / 2e-6)
        evaluate(x0, u0)
        found = jacobian(fmu, unknowns, (states[0] + inputs[0], n_x + n_u))
        scale = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(found, np.array(expected).T, rtol=0, atol=DIFFERENCES * scale)
        if not fmu.two:
            rows = [
                fmu.fmu.getAdjointDerivative(unknowns[0], states[0] + inputs[0], row.tolist(), n_x + n_u)
                for row in np.eye(unknowns[1])
            ]
            np.testing.assert_allclose(rows, found, rtol=1e-12, atol=1e-12 * scale)
        refs = unknowns[0]
        wrong = [0]  # time
        if fmu.two:
            assert refused(fmu.fmu.getDirectionalDerivative, refs, wrong, [1.0]) == ERROR
        else:
            assert refused(fmu.fmu.getDirectionalDerivative, refs, wrong, [1.0], unknowns[1]) == ERROR
            assert refused(fmu.fmu.getAdjointDerivative, wrong, refs, [1.0], unknowns[1]) == ERROR


def test_derivative_with_respect_to_parameters():
    path = exported("oscillator", "3.0")
    refs = {v.name: v.valueReference for v in described(path).modelVariables}
    with Instance(path, "me") as fmu:
        fmu.start(mass=2.0)
        fmu.fmu.setContinuousStates((ctypes.c_double * 2)(0.5, 3.0), 2)
        found = fmu.fmu.getDirectionalDerivative([refs["der(speed)"]], [refs["stiffness"]], [1.0], 1)
        assert found[0] == pytest.approx(-0.5 / 2.0, rel=1e-14)


@pytest.mark.parametrize("name", MODELS)
def test_dependencies_are_those_of_the_derivatives(name):
    """Element by element, FMI 3: no entry of the Jacobian outside the dependencies, none inside that is always 0."""
    path = exported(name, "3.0")
    unknowns = names_of(path, "derivative", "output")[0]
    sizes = {v.valueReference: int(np.prod(v.shape)) for v in described(path).modelVariables}
    with Instance(path, "me") as fmu:
        fmu.start()
        library, component = fmu.fmu.dll, fmu.fmu.component
        for unknown in unknowns:
            count = ctypes.c_size_t()
            assert library.fmi3GetNumberOfVariableDependencies(component, unknown, ctypes.byref(count)) == 0
            n = count.value
            rows, columns = (ctypes.c_size_t * n)(), (ctypes.c_size_t * n)()
            independents, kinds = (ctypes.c_uint32 * n)(), (ctypes.c_int * n)()
            call = library.fmi3GetVariableDependencies
            assert call(component, unknown, rows, independents, columns, kinds, ctypes.c_size_t(n)) == 0
            assert (
                call(component, unknown, rows, independents, columns, kinds, ctypes.c_size_t(n + 1)) == ERROR
            )
            listed = {(rows[i], independents[i], columns[i]) for i in range(n)}
            for known in set(names_of(path, "state", "input")[0]):
                matrix = jacobian(fmu, ([unknown], sizes[unknown]), ([known], sizes[known]))
                for row, column in zip(*np.nonzero(matrix), strict=True):
                    place = (
                        row + 1 if sizes[unknown] > 1 else 0,
                        known,
                        column + 1 if sizes[known] > 1 else 0,
                    )
                    assert place in listed


def test_no_false_feedthrough():
    structure = {
        u.variable.name: {d.name for d in u.dependencies} for u in described(exported("loop", "3.0")).outputs
    }
    assert structure == {"s": {"plant.s"}, "v": {"plant.v"}, "f_hat": set()}
    structure = {
        u.variable.name: {d.name for d in u.dependencies}
        for u in described(exported("continuous", "2.0")).outputs
    }
    assert "g[0]" not in structure["f_hat[0]"]
    assert {"x[0]", "f_theta[0]"} <= structure["f_hat[0]"]
    assert "x[1]" not in structure["f_hat[0]"]


# ---- parameters ----


@pytest.mark.parametrize("fmi", VERSIONS)
def test_retuning_while_running(fmi):
    """A new filter comes into force at the next step, without a jump, and is the one Python gives."""
    sampled, other = FILTER.sampled(PERIOD), pf.PhyFilter.from_poles([-30.0 + 10.0j, -30.0 - 10.0j])
    rng = np.random.default_rng(2)
    x = np.cumsum(rng.normal(0.0, 0.01, (60, 3)), axis=0)
    state = sampled.start(x[0], f_theta0=np.zeros(3))
    zero = np.zeros(3)
    with Instance(exported("sampled", fmi)) as fmu:
        fmu.start(x=x[0])
        for k in range(1, 60):
            if k == 30:
                before = fmu.get("f_hat")
                fmu.set(a=other.a)
                assert np.array_equal(fmu.get("a"), other.a)  # staged
                assert np.array_equal(fmu.get("f_hat"), before)
                state, sampled = sampled.retune(state, other), sampled.with_filter(other)
            fmu.step(PERIOD, x=x[k])
            state, f_hat = sampled.step(state, x[k], zero, zero)
            np.testing.assert_allclose(fmu.get("f_hat"), f_hat, rtol=0, atol=RETUNED)
        assert fmu.get("b")[0] == other.a[0]  # a low-pass filter stays one


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", ["sampled", "continuous"])
def test_retuning_at_rest(name, fmi):
    """The estimate of a constant residual stays where it is, not only at the instant."""
    with Instance(exported(name, fmi)) as fmu:
        fmu.start(x=0.0, g=-5.0)
        for _ in range(5):
            fmu.step(2.0)
        before, a, b = (fmu.get(variable) for variable in ("f_hat", "a", "b"))
        np.testing.assert_allclose(before, 5.0, rtol=1e-9)  # settled
        fmu.set(a=a * np.linspace(1.5, 1.0, len(a)), b=1.5 * b)
        for _ in range(60):
            fmu.step(PERIOD)
            np.testing.assert_allclose(fmu.get("f_hat"), before, rtol=1e-9)


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", ["sampled", "continuous"])
def test_bad_parameters_are_refused_together(name, fmi):
    with Instance(exported(name, fmi)) as fmu, Instance(exported(name, fmi)) as twin:
        fmu.start()
        twin.start()
        drive(fmu, name, 10)
        drive(twin, name, 10)
        old = fmu.get("a")
        for a in (np.full(len(old), -1.0), np.full(len(old), np.nan)):
            fmu.set(a=a)
            answer = fmu.fmu.doStep(fmu.time, PERIOD)  # a warning, which fmpy lets pass
            fmu.time += PERIOD
            assert answer is None or answer[3] > 0
            twin.step(PERIOD)
            if not fmu.two:
                assert "refused" in fmu.messages[-1]
            assert np.array_equal(fmu.get("a"), old)
        assert np.array_equal(fmu.get("f_hat"), twin.get("f_hat"))
        assert np.array_equal(drive(fmu, name, 10), drive(twin, name, 10))


@pytest.mark.parametrize("fmi", VERSIONS)
def test_retuning_in_event_mode(fmi):
    """Model exchange: the states move with the coefficients so that f_hat does not, and the importer is told."""
    path = exported("continuous", fmi)
    n = names_of(path, "state")[1]
    with Instance(path, "me") as fmu:
        fmu.start(x=1.0)
        fmu.fmu.setContinuousStates((ctypes.c_double * n)(*np.linspace(-0.3, 1.0, n)), n)
        fmu.fmu.enterEventMode()
        before = fmu.get("f_hat")
        assert refused(fmu.fmu.setContinuousStates, doubles(n), n) == ERROR
        fmu.set(a=GENERAL.a * [1.3**3, 1.3**2, 1.3])
        changed = (fmu.fmu.newDiscreteStates() if fmu.two else fmu.fmu.updateDiscreteStates())[3]
        assert changed
        np.testing.assert_allclose(fmu.get("f_hat"), before, rtol=0, atol=1e-9)
        fmu.fmu.enterContinuousTimeMode()
        assert refused(fmu.set, a=GENERAL.a) == ERROR  # not in Continuous-Time Mode


# ---- refusals ----


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_step_on_a_bad_input_is_discarded(name, fmi, bad):
    """The state stays, the log says which input it was, and the run goes on as if nothing had been."""
    signal = INPUTS[name][0]
    with Instance(exported(name, fmi)) as fmu, Instance(exported(name, fmi)) as twin:
        fmu.start()
        twin.start()
        drive(fmu, name, 5)
        drive(twin, name, 5)
        last = fmu.get(signal)
        broken = last.copy()
        broken[-1] = bad
        fmu.set(**{signal: broken})
        assert refused(fmu.fmu.doStep, fmu.time, PERIOD) == DISCARD
        if not fmu.two:
            text = signal if len(broken) == 1 else f"{signal}[{len(broken) - 1}]"
            assert f"'{text}' is not finite" in fmu.messages[-1]
        fmu.set(**{signal: last})
        assert np.array_equal(drive(fmu, name, 5, seed=9), drive(twin, name, 5, seed=9))


@pytest.mark.parametrize("fmi", VERSIONS)
def test_steps_that_cannot_be(fmi):
    with Instance(exported("oscillator", fmi), stopTime=1.0) as fmu:
        fmu.start()
        for t, h in (
            (0.0, 0.0),
            (0.0, -0.1),
            (0.0, np.nan),
            (np.nan, 0.1),
            (0.0, np.inf),
            (0.5, 0.1),
            (0.0, 1.1),
        ):
            assert refused(fmu.fmu.doStep, t, h) == ERROR
        fmu.step(1.0)
        assert refused(fmu.fmu.doStep, 1.0, 0.1) == ERROR
    with Instance(exported("oscillator", fmi)) as fmu:
        fmu.start()
        assert (
            refused(fmu.fmu.doStep, 0.0, 1e9) == ERROR
        )  # a slip in the importer's units, not an endless loop


@pytest.mark.parametrize("fmi", VERSIONS)
def test_wrong_references_counts_and_modes(fmi):
    with Instance(exported("oscillator", fmi)) as fmu:
        get, set_ = (
            (fmu.fmu.getReal, fmu.fmu.setReal) if fmu.two else (fmu.fmu.getFloat64, fmu.fmu.setFloat64)
        )
        refs = {v.name: v.valueReference for v in fmu.description.modelVariables}
        assert refused(get, [999]) == ERROR
        assert refused(get, [2**32 - 1]) == ERROR
        assert refused(set_, [refs["place"]], [1.0]) == ERROR  # an output
        assert refused(set_, [refs["pull"]], [1.0]) == ERROR
        assert refused(set_, [refs["der(speed)"]], [1.0]) == ERROR
        assert refused(set_, [refs["time"]], [1.0]) == ERROR
        assert refused(get, [0]) == ERROR  # none
        assert refused(fmu.fmu.doStep, 0.0, 0.1) == ERROR
        assert refused(fmu.fmu.terminate) == ERROR
        assert refused(fmu.fmu.exitInitializationMode) == ERROR
        fmu.start()
        assert refused(fmu.fmu.enterInitializationMode) == ERROR
        # Nothing is half set.
        assert refused(set_, [refs["force"], refs["place"]], [7.0, 1.0]) == ERROR
        assert fmu.get("force")[0] == 0.0
        assert refused(set_, [refs["solver.step"]], [1e-4]) == ERROR  # fixed
        if not fmu.two:
            raw = fmu.fmu.dll.fmi3GetFloat64
            vr = (ctypes.c_uint32 * 1)(refs["place"])
            for n in (0, 2):
                assert raw(fmu.fmu.component, vr, ctypes.c_size_t(1), doubles(3), ctypes.c_size_t(n)) == ERROR
            assert raw(fmu.fmu.component, None, ctypes.c_size_t(1), doubles(3), ctypes.c_size_t(1)) == ERROR
            assert raw(fmu.fmu.component, vr, ctypes.c_size_t(1), None, ctypes.c_size_t(1)) == ERROR
            assert raw(None, vr, ctypes.c_size_t(1), doubles(1), ctypes.c_size_t(1)) == ERROR
            assert refused(fmu.fmu.getInt32, [1]) == ERROR
        fmu.step(0.1)
        assert np.isfinite(fmu.get("place")).all()


@pytest.mark.parametrize("fmi", VERSIONS)
def test_wrong_token(fmi):
    path = exported("oscillator", fmi)
    description = copy(described(path))
    description.guid = "{0}"
    with pytest.raises(Exception, match=r"[Ii]nstantiate"):
        fmpy.simulation.instantiate_fmu(
            str(unpacked(path)), description, "CoSimulation", logger=lambda *_: None
        )


# ---- intermediate update and early return ----


def test_intermediate_update_shows_and_changes_the_step():
    """A force that follows the state inside one communication step, as in many small ones."""
    path = exported("oscillator", "3.0")
    seen = []
    holder = {}

    def update(_env, time, set_requested, get_allowed, finished, can_return, _request, _until):
        fmu = holder["fmu"]
        assert set_requested
        assert get_allowed
        assert finished
        assert not can_return
        seen.append((time, fmu.get("place")[0]))
        fmu.set(force=-2.0 * fmu.get("speed")[0])

    with Instance(path, intermediate=fmi3.fmi3IntermediateUpdateCallback(update)) as fmu:
        holder["fmu"] = fmu
        fmu.start(**{"solver__step": 0.01})
        fmu.step(1.0)
        found = fmu.get("place", "speed")
    assert [round(t, 9) for t, _ in seen] == [round(0.01 * k, 9) for k in range(1, 100)]
    with Instance(path) as fmu:
        fmu.start(**{"solver__step": 0.01})
        force = 0.0
        for _ in range(100):
            fmu.step(0.01, force=force)
            force = -2.0 * fmu.get("speed")[0]
        np.testing.assert_allclose(found, fmu.get("place", "speed"), rtol=0, atol=1e-12)


def test_early_return_on_request():
    path = exported("oscillator", "3.0")

    def update(_env, time, _set, _get, _finished, can_return, request, until):
        assert can_return
        if time >= 0.2:
            request[0] = True
            until[0] = 0.254

    with Instance(path, early_return=True, intermediate=fmi3.fmi3IntermediateUpdateCallback(update)) as fmu:
        fmu.start(**{"solver__step": 0.01})
        _, terminate, early, reached = fmu.step(1.0)
        assert early
        assert not terminate
        assert reached == pytest.approx(0.254, abs=1e-12)
        found = fmu.get("place")[0]
        twin_time = fmu.time
    with Instance(path) as twin:
        twin.start(**{"solver__step": 0.01})
        twin.step(twin_time)
        assert found == pytest.approx(twin.get("place")[0], abs=1e-8)
