"""Which g each way of running a filter takes: a white known force and no unknown one, so that f_hat must be zero.

With ``g="hold"`` some take the g that acts from this sample on, others the g that acted since the last sample. Every
way is fed both, and the one that is documented for it is right, the other one wrong. With ``g="average"`` all take g at
this sample.
"""

import ctypes
import re
from pathlib import Path
from types import SimpleNamespace

import control as ct
import fmpy
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.blocks import adaptive_block
from phyfilter_ctl.codegen import compile_model
from phyfilter_ctl.codegen.compiler import compile_sources
from phyfilter_ctl.codegen.export_folder import own_symbols
from phyfilter_ctl.codegen.filter_code import filter_source
from phyfilter_ctl.codegen.filter_guard import guard_sources
from phyfilter_ctl.codegen.fixed_source import fixed_source
from phyfilter_ctl.controllers.l1_adaptive import l1_adaptive
from phyfilter_ctl.estimation import ColouredForce
from phyfilter_ctl.learned import AdaptiveChebyshev, Chebyshev
from phyfilter_ctl.wrappers import FeedForward, ForceEstimator, LoopModel
from tests.codegen.filter_harness import CFilter, compile_filters
from tests.fmi.exported_fmus import Instance, quick_compiler

ROOT = Path(__file__).parents[1]
ACCESS = ROOT / "tests/c/guard_access.c"
H, N, CHANNELS = 0.01, 60, 3
FILTER = pf.PhyFilter([400.0, 40.0])
TIMES = H * np.arange(N)
# Rounding of x by some ten steps of 1e-16, over H, and as much again by each recursion.
ZERO = 1e-12
# What the other g leaves, of a force of deviation 1: F of the difference of two of its samples.
WRONG = 0.05
# q31 rounds f_hat and all that goes into it; its own bound is checked in tests/codegen. An adaptive law multiplies the
# rounding of its model's fit by its rate, and answers with a part of the force.
COARSE, ADAPTIVE = (1e-6, WRONG), (1e-10, 0.01)
OTHERWISE = {"C in q31": COARSE, "fixed_point.run": COARSE} | dict.fromkeys(
    ("adaptive_block", "AdaptiveChebyshev.step"), ADAPTIVE
)


def motion(rule):
    """x of x' = g, and g itself, (N, n_x) each."""
    g = np.random.default_rng(37).standard_normal((N, CHANNELS))
    over = g[:-1] if rule == "hold" else 0.5 * (g[:-1] + g[1:])
    return np.vstack([np.zeros(CHANNELS), np.cumsum(H * over, axis=0)]), g


def by_run(sampled, x, g, folder):
    return sampled.run(x, g)


def by_step(sampled, x, g, folder):
    state = sampled.start(x[0], g0=g[0])
    rows = [np.zeros(CHANNELS)]
    for k in range(1, N):
        state, f_hat = sampled.step(state, x[k], g[k])
        rows.append(f_hat)
    return rows


def by_live(sampled, x, g, folder):
    live = sampled.live(CHANNELS)
    return [live.step(TIMES[k], x[k], g[k]).copy() for k in range(N)]


def by_c(sampled, x, g, folder):
    source = filter_source(sampled, CHANNELS, name="wing")
    wing = CFilter(compile_filters([source], folder), source)
    return [wing.step(x[k], g[k], np.zeros(CHANNELS))[1] for k in range(N)]


def by_guard(sampled, x, g, folder):
    """What the packages for targets call; two channels."""
    source = filter_source(sampled, 2, name="craft")
    texts = own_symbols(source.sources, "craft") | guard_sources("craft", 0)
    texts["access.c"] = ACCESS.read_text().replace("PLACES_OF_OPTIONS", "AT(C)")
    c = ctypes.CDLL(str(compile_sources(texts, folder / "guard.so", flags=["-fvisibility=default"])))
    assert c.begin() == 0
    rows = []
    for k in range(N):
        arrays = [np.ascontiguousarray(row[:2]) for row in (x[k], g[k], np.zeros(2), np.zeros(2))]
        time = ctypes.c_uint64(round(1e6 * TIMES[k]) + 1_000_000)
        assert c.step(time, *(ctypes.c_void_p(a.ctypes.data) for a in arrays), None) == 0
        rows.append(arrays[3])
    return rows


def by_q31(sampled, x, g, folder):
    fixed = pf.fixed_point(sampled, x=2.0, g=6.0)
    files = fixed_source(fixed, CHANNELS, name="wing")
    del files["main.c"]
    files["size.c"] = (
        '#include "wing.h"\nunsigned wing_size(void);\nunsigned wing_size(void) { return sizeof(wing); }\n'
    )
    c = ctypes.CDLL(str(compile_sources(files, folder / "wing.so", flags=["-fvisibility=default"])))
    memory = ctypes.create_string_buffer(c.wing_size())
    numbers = ctypes.addressof(ctypes.c_char.in_dll(c, "wing_parameters"))
    assert c.wing_init(memory, ctypes.c_void_p(numbers)) == 0
    rows, zero, out = [], np.zeros(CHANNELS, np.int32), np.zeros(CHANNELS, np.int32)
    given = [np.rint(v * 2.0 ** fixed.fraction[n]).astype(np.int32) for n, v in (("x", x), ("g", g))]
    for k in range(N):
        arrays = (given[0][k].copy(), given[1][k].copy(), zero, out)
        assert c.wing_step(memory, *(ctypes.c_void_p(a.ctypes.data) for a in arrays)) == 0
        rows.append(fixed.reals("f_hat", out))
    return rows


def by_q31_run(sampled, x, g, folder):
    fixed = pf.fixed_point(sampled, x=2.0, g=6.0)
    given = [np.rint(v * 2.0 ** fixed.fraction[n]).astype(np.int64) for n, v in (("x", x), ("g", g))]
    return fixed.reals("f_hat", fixed.run(*given)[0])


def by_fmu(fmi, rate="communication"):
    def run(sampled, x, g, folder):
        path = folder / "filter.fmu"
        if not path.exists():
            ports = pf.fmi.FmuPorts(channels=CHANNELS)
            options = {"fmi": fmi, "kinds": ("cs",), "rate": rate, "ports": ports}
            pf.export_fmu(sampled, path, compiler=quick_compiler(), **options)
        _describes(path, sampled.sampling.g)
        with Instance(path) as wing:
            rows = [wing.start(x=x[0], g=g[0]).get("f_hat")]
            for k in range(1, N):  # a sample is taken at the end of a step, on the inputs set before it
                wing.step(H, x=x[k], g=g[k])
                rows.append(wing.get("f_hat"))
        return rows

    return run


def by_fmpy(fmi, **options):
    """FMPy's own loop, which sets the inputs of a point and then steps to the next."""

    def run(sampled, x, g, folder):
        path = folder / "filter.fmu"
        if not path.exists():
            ports = pf.fmi.FmuPorts(channels=CHANNELS, arrays=False)
            pf.export_fmu(sampled, path, fmi=fmi, rate="fixed", ports=ports, compiler=quick_compiler())
        return fmpy_run(path, x, g, **options)

    return run


def fmpy_run(path, x, g, **options):
    n = x.shape[1]
    names = ["time", *(f"{letter}[{i}]" for letter in ("x", "g", "f_theta") for i in range(n))]
    table = np.rec.fromarrays([TIMES[: len(x)], *x.T, *g.T, *np.zeros_like(x.T)], names=names)
    outputs = [f"f_hat[{i}]" for i in range(n)]
    found = fmpy.simulate_fmu(
        str(path), stop_time=TIMES[len(x) - 1], output_interval=H, input=table, output=outputs, **options
    )
    last = np.searchsorted(found["time"], TIMES[: len(x)] + 1e-9) - 1  # what stands there after the event
    return np.column_stack([found[name] for name in outputs])[last]


def _describes(path, rule):
    variables = fmpy.read_model_description(str(path)).modelVariables
    text = next(v.description for v in variables if v.name in ("g", "g[0]"))
    assert ("that acts from this sample on" if rule == "hold" else "at this sample") in text


def by_block(maker):
    def run(sampled, x, g, folder):
        signals = np.hstack([x, g]).T
        block = maker(sampled)
        return pf.simulate(block, TIMES, signals, interpolation="hold").outputs[:CHANNELS].T

    return run


def by_separation(sampled, x, g, folder):
    """A filter of another kind, which takes g like one."""
    parts = [ColouredForce(1.0, bandwidth=20.0)]
    block = pf.separation_block(parts, CHANNELS, dt=H, noise=0.001, g=sampled.sampling.g)
    assert block.input_labels[CHANNELS] == "g[0]"
    signals = np.hstack([x, g, np.zeros_like(x)]).T
    return pf.simulate(block, TIMES, signals, interpolation="hold").outputs[:CHANNELS].T


def by_l1(sampled, x, g, folder):
    block = l1_adaptive(dt=H, pole=-2.0, bandwidth=20.0, channels=CHANNELS, g=sampled.sampling.g)
    return pf.simulate(block, TIMES, np.hstack([x, g]).T, interpolation="hold").outputs.T


def adaptive(sampled):
    """f_theta = -d v with d = 0 at the start: as long as nothing is unknown, it stays there."""
    v, d = np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(0.0, 1.0, 5))
    model = Chebyshev(2, degree_d=1).fit(
        np.column_stack([v.ravel(), d.ravel()]), np.outer((-d * v).ravel(), np.ones(CHANNELS))
    )
    return AdaptiveChebyshev(model.model, H, rate=2e4, prior=[1.0, -1.0], g=sampled.sampling.g)


def by_adaptive_step(sampled, x, g, folder):
    law = adaptive(sampled)
    state, rows = law.start(x[0, :1], x[0], g[0]), []
    for k in range(1, N):
        state, f_theta = law.step(state, x[k, :1], x[k], g[k])
        rows.append(f_theta)
    return rows


def by_adaptive_block(sampled, x, g, folder):
    signals = np.hstack([x[:, :1], x, g]).T
    response = pf.simulate(adaptive_block(adaptive(sampled)), TIMES, signals, interpolation="hold")
    return response.outputs[:CHANNELS].T


def by_c_of_a_block(sampled, x, g, folder):
    flat = pf.flatten(pf.sampled_block(sampled, CHANNELS, f_theta=False))
    return compile_model(flat).simulate(TIMES, np.hstack([x, g]), interpolation="hold").outputs


def by_python_control(sampled, x, g, folder):
    block = pf.phyfilter_block(sampled, CHANNELS, f_theta=False)
    start = block.rest_state(x[0], g[0])
    return ct.forced_response(block, TIMES, np.hstack([x, g]).T, X0=start).outputs.T


def by_feedforward(sampled, x, g, folder):
    """A loop that sends g itself, with nothing added for f_hat."""
    wheel = LoopModel(x=lambda y: y, g=lambda y, u: u, compensate=lambda y, f_hat: 0.0 * f_hat)
    feedforward = FeedForward(sampled.live(CHANNELS), wheel)
    rows = []
    for k in range(N):
        feedforward(TIMES[k], x[k], g[k])
        rows.append(feedforward.live.f_hat.copy())
    return rows


def by_messages(sampled, x, g, folder):
    """The velocity of a time, then the force from then on."""
    estimator = ForceEstimator(sampled.live(CHANNELS), mass=1.0, frame_id="map")

    def message(k, **body):
        stamp = SimpleNamespace(sec=0, nanosec=round(1e9 * TIMES[k]))
        return SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id="map"), **body)

    def vector(values):
        return SimpleNamespace(**dict(zip("xyz", values, strict=True)))

    rows = []
    for k in range(N):
        rows.append(estimator.on_velocity(message(k, twist=SimpleNamespace(linear=vector(x[k])))).copy())
        estimator.on_force(message(k, wrench=SimpleNamespace(force=vector(g[k]))))
    return rows


BLOCKS = by_block(lambda sampled: pf.sampled_block(sampled, CHANNELS, f_theta=False))
FROM_NOW_ON = {
    "run": by_run,
    "fixed_point.run": by_q31_run,
    "sampled_block": BLOCKS,
    "separation_block": by_separation,
    "l1_adaptive": by_l1,
    "adaptive_block": by_adaptive_block,
    "AdaptiveChebyshev.step": by_adaptive_step,
    "sampled_block in C": by_c_of_a_block,
    "phyfilter_block": by_python_control,
    "FMU 2": by_fmu("2.0"),
    "FMU 3": by_fmu("3.0"),
    "FMU 3, fixed rate": by_fmu("3.0", rate="fixed"),
    "FMU 2, model exchange": by_fmpy("2.0", fmi_type="ModelExchange"),
    "FMU 3, event mode": by_fmpy("3.0", fmi_type="CoSimulation", use_event_mode=True),
}
ONLY_HELD = {"FeedForward": by_feedforward, "ForceEstimator": by_messages}
SINCE = {"step": by_step, "live.step": by_live, "C": by_c, "C in q31": by_q31, "C, guard": by_guard}
BUILT = {name for name in FROM_NOW_ON | SINCE if "C" in name or "FMU" in name}
QUICK = BUILT - {name for name in BUILT if "," in name}
CASES = [
    pytest.param(rule, name, id=f"{name}-{rule}", marks=[] if quick else pytest.mark.slow)
    for rule in ("hold", "average")
    for name in FROM_NOW_ON | SINCE | ONLY_HELD
    for quick in (name not in BUILT or (rule == "hold" and name in QUICK),)
    if rule == "hold" or name not in ONLY_HELD
]


@pytest.mark.parametrize(("rule", "name"), CASES)
def test_the_documented_g_leaves_nothing_and_the_other_one_does(rule, name, tmp_path):
    way = (FROM_NOW_ON | SINCE | ONLY_HELD)[name]
    x, now = motion(rule)
    since = np.vstack([np.zeros(CHANNELS), now[:-1]])
    right, wrong = (since, now) if rule == "hold" and name in SINCE else (now, since)
    sampled = FILTER.sampled(H, g=rule)
    worst = [float(np.abs(way(sampled, x, g, tmp_path)).max()) for g in (right, wrong)]
    zero, other = OTHERWISE.get(name, (ZERO, WRONG))
    assert worst[0] < zero
    assert worst[1] > other


def test_inputs_held_over_a_step_cost_a_sample(tmp_path):
    """FMPy's co-simulation sets the inputs of the beginning of a step: f_hat is late by one, exactly, and the first
    sample counts twice, so that g[0] acts over a step in which x stood still; F forgets that."""
    path = tmp_path / "filter.fmu"
    pf.export_fmu(
        FILTER.sampled(H, channels=1),
        path,
        fmi="2.0",
        compiler=quick_compiler(),
        ports=pf.fmi.FmuPorts(arrays=False),
    )
    f, weight = np.sin(2.0 * TIMES)[:, None], np.full((N, 1), -9.81)
    x = np.vstack([[0.0], np.cumsum(H * (f + weight), axis=0)[:-1]])
    found = fmpy_run(path, x, weight, fmi_type="CoSimulation")
    doubled = FILTER.sampled(H).run(np.vstack([x[:1], x[:-1]]), np.vstack([weight[:1], weight[:-1]]))
    np.testing.assert_allclose(found, doubled, atol=ZERO)
    assert np.abs(found - FILTER.sampled(H).run(x, weight)).max() > WRONG


@pytest.mark.slow
def test_the_page_on_fmus_is_right(tmp_path, monkeypatch, capsys):
    """The blocks of docs/loops.md under its heading on FMUs, and their figures."""
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs/loops.md").read_text().split("by FMU\n")[1]
    names = {"np": np, "pf": pf}
    for block in re.findall(r"```python\n(.*?)```", text, re.S):
        exec(compile(block, "docs/loops.md", "exec"), names)
    printed = [float(figure) for figure in capsys.readouterr().out.split()[-2:]]
    assert [f"{figure:.1g}" for figure in printed] == ["0.1", "0.004"]


@pytest.mark.parametrize(
    ("rule", "said"), [("hold", "the g that acted since the last sample"), ("average", "g at this sample")]
)
@pytest.mark.parametrize("real", ["double", "q31"])
def test_the_generated_c_says_which(rule, said, real, tmp_path):
    ranges = {"x": 2.0, "g": 6.0} if real == "q31" else None
    pf.export_c(FILTER.sampled(H, g=rule), tmp_path / "c", real=real, channels=2, name="wing", ranges=ranges)
    for file in ("wing.h", "main.c"):
        assert said in (tmp_path / "c" / file).read_text()
