"""One period of an exported diagram: bits of a whole run, true time after a day, failures that leave no trace."""

import ctypes
import subprocess

import casadi as ca
import control as ct
import numpy as np
import pytest
from filter_harness import CFilter, compile_filters
from flat_models import STRICT, law, model, symbols, two_rates

import phyfilter_ctl as pf
from phyfilter_ctl.blocks.functions import Variable
from phyfilter_ctl.codegen import compile_model
from phyfilter_ctl.codegen.compiler import compile_sources
from phyfilter_ctl.codegen.diagram_source import diagram_model
from phyfilter_ctl.codegen.filter_code import filter_source
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.diagram.model import Task

FLOAT_EPS = float(np.finfo(np.float32).eps)

LATE = """\
#include <stdio.h>
#include "late.h"

int main(void) {
  static late self;
  pf_real y[LATE_N_Y], u[1] = {0};
  if (late_init(&self)) return 1;
  self.start = 0;
  self.steps = 43200122; /* a day at 500 Hz, and a time that float does not have */
  self.ticks[0] = self.steps;
  self.ticks[1] = self.steps / 2;
  if (late_step(&self, u, y)) return 2;
  for (int i = 0; i < LATE_N_Y; i++) printf("%a ", (double)y[i]);
  for (int i = 0; i < LATE_N_X; i++) printf("%a ", (double)self.x[i]);
  printf("%d %d", (int)(self.ticks[0] - 43200123), (int)(self.ticks[1] - 21600062));
  return 0;
}
"""

DISTURBED = """\
#include <stdio.h>
#include <string.h>
#include "loop.h"

int main(void) {
  static loop calm, disturbed, before;
  pf_real y[LOOP_N_Y], other[LOOP_N_Y];
  const pf_real none = (pf_real)1e300, bad[3] = {none * none, none * none - none * none, (pf_real)%(huge)s};
  if (loop_init(&calm) || loop_init(&disturbed)) return 1;
  for (int k = 0; k < 200; k++) {
    pf_real u[2] = {(pf_real)(k %% 7) / 8, (pf_real)(k %% 5) / 16};
    if (loop_step(&calm, u, y)) return 2;
    for (int i = 0; i < 6; i++) { /* not finite, or overflowing on the way: in the first step too */
      pf_real wrong[2] = {u[0], u[1]};
      wrong[i / 3] = bad[i %% 3];
      before = disturbed;
      const int status = loop_step(&disturbed, wrong, other);
      if (status != PF_NOT_FINITE) return 10 + i;
      if (memcmp(&before, &disturbed, sizeof before)) return 20 + i;
    }
    if (loop_step(&disturbed, u, u)) return 3; /* results may take the place of the inputs */
    if (memcmp(u, y, sizeof y)) return 4;
    if (memcmp(&calm, &disturbed, sizeof calm)) return 5;
  }
  printf("done %%g", (double)y[0]);
  return 0;
}
"""


def program(sources, main, folder, *flags):
    built = compile_sources(
        sources | {"main.c": main}, folder / "program", kind="program", flags=[*STRICT, *flags]
    )
    run = subprocess.run([built], capture_output=True, text=True, check=False)
    assert run.returncode == 0, (run.returncode, run.stderr)
    return run.stdout.split()


def timed():
    """Two sampled laws and an integrator, all of which read time."""
    arguments = symbols(2, 1, 1, 2)
    t, x, u, p, z = arguments
    dx = ca.vertcat(ca.sin(50 * t) + u, ca.if_else(ca.fmod(t, 0.003) < 0.0015, 1, -1))
    y = ca.vertcat(ca.sin(50 * t), 0.1 * t - 8600 * p[0], ca.fmod(t, 0.7) + x[0] * ca.cos(p[0] * t), z)
    signals = ca.Function("v", arguments, [ca.vertcat(ca.cos(30 * t), x[0])])
    tasks = tuple(
        Task(name, period, law(3.0), signals, slice(i, i + 1), slice(0, 0))
        for i, (name, period) in enumerate((("fast", 0.002), ("slow", 0.004)))
    )
    held = (Variable("fast.o"), Variable("slow.o"))
    return model("late", arguments, dx, y, starts=(0.5, 0.0), parameters=(1.0,), tasks=tasks, held=held)


@pytest.mark.slow
@pytest.mark.parametrize("piece", [3, 500])
def test_time_is_true_after_a_day_in_float(piece, monkeypatch, tmp_path):
    monkeypatch.setattr("phyfilter_ctl.codegen.scalar_source._PIECE", piece)
    flat = timed()
    answer = program(
        diagram_model(flat, real="float", derivatives=False).sources, LATE, tmp_path, "-Wconversion"
    )
    got = np.array([float.fromhex(word) for word in answer[:-2]])
    assert answer[-2:] == ["0", "0"]
    t, x, p = 43_200_122 * 0.002, np.array([0.5, 0.0]), [1.0]
    out = -3.0 * np.cos(30 * t) + 0.1 * x[0] + 0.01 * 0.5 + t
    y = np.asarray(flat.output(t, x, 0.0, p, [out, out])).ravel()
    h, middle = 0.002, t + 0.001
    rates = [np.asarray(flat.dynamics(at, x, 0.0, p, [0.0, 0.0])).ravel() for at in (t, middle, t + h)]
    x = x + h / 6 * (rates[0] + 4 * rates[1] + rates[2])
    # Results are rounded once, sums and products in float a few times more.
    np.testing.assert_allclose(got, [*y, *x], rtol=4 * FLOAT_EPS, atol=2 * FLOAT_EPS)


@pytest.mark.slow
def test_step_has_the_bits_of_a_whole_run(tmp_path):
    """Integer ticks against pf_run.c, which finds its stops by times; CasADi's machine adds and multiplies the same."""
    flat, n = two_rates(), 3000
    sources = diagram_model(flat).sources
    library = ctypes.CDLL(str(compile_sources(sources, tmp_path / "a.so", flags=["-fvisibility=default"])))
    memory = (ctypes.c_char * 4096)()
    library.two_rates_init(memory)
    u, y = np.random.default_rng(6).normal(size=(n, 1)), np.empty((n, 3))
    for row, result in zip(u, y, strict=True):
        assert not library.two_rates_step(
            memory, ctypes.c_void_p(row.ctypes.data), ctypes.c_void_p(result.ctypes.data)
        )
    run = compile_model(flat).simulate(0.001 * np.arange(n), u, interpolation="hold")
    np.testing.assert_array_equal(y, run.outputs)


def servo(order=6):
    """A PI law, a filter and a plant of two states."""
    plant = pf.plant(
        lambda t, x, u, p: {"q": x.v, "v": (u.thrust - p.drag * x.v * abs(x.v) - 4.0 * x.q) / p.mass},
        states={"q": (0.0, "m"), "v": (0.0, "m/s")}, inputs={"thrust": (0.0, "N")},
        params={"drag": (0.3, "kg/m"), "mass": (1.2, "kg")}, name="plant",
    )  # fmt: skip
    pi = ct.ss(
        [1.0], [[0.02, -0.02]], [3.0], [[4.0, -4.0]], dt=0.002, inputs=["goal", "q"], outputs=["u"], name="pi"
    )
    observer = pf.PhyFilter.from_poles([-20.0] * order).sampled(0.002)
    return ct.interconnect(
        [plant, pf.sampled_block(pi, name="pi"), pf.sampled_block(observer, channels=1, name="observer")],
        connections=[
            ["plant.thrust", "pi.u", "-observer.f_hat[0]"], ["pi.q", "plant.q"], ["observer.x[0]", "plant.v"],
            ["observer.g[0]", "pi.u"],
        ],
        inplist=["pi.goal", "observer.f_theta[0]"], inputs=["goal", "f_theta"],
        outlist=["plant.q", "observer.f_hat[0]"], outputs=["q", "f_hat"], name="loop",
    )  # fmt: skip


def test_constant_numbers_are_no_state():
    """What cannot be tuned stays in the constant parameters; a filter of other parameters cannot be one of these."""
    options = {"name": "wing", "variable": False, "fixed": True}
    sampled = pf.PhyFilter.from_poles([-20.0] * 3).sampled(0.002)
    assert filter_source(sampled, 1, tunable=False, **options).fixed
    assert not filter_source(sampled, 1, tunable=True, **options).fixed
    late = pf.PhyFilter([20.0]).sampled(0.002, delay=0.001)
    assert not filter_source(late, 1, tunable=False, **options).fixed


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(
    ("options", "inertia"),
    [
        ({"g": "average", "f_theta": "hold"}, 1.3),
        ({"limit": 0.8, "g_limit": (-0.4, 0.6)}, [1.1, 0.7]),
        ({"E": [[1.0], [2.0]]}, "full"),
    ],
)
def test_a_filter_of_constant_numbers_has_the_same_bits(precision, options, inertia, tmp_path):
    sampled = pf.PhyFilter([800.0, 60.0, 30.0], [700.0, 20.0, 3.0]).sampled(
        0.002, precision=precision, **options
    )
    sources = [
        filter_source(
            sampled, 2, name=f"wing_{fixed}", inertia=inertia, variable=False, tunable=False, fixed=fixed
        )
        for fixed in (False, True)
    ]
    library = compile_filters(sources, tmp_path)
    rng = np.random.default_rng(3)
    results, filters = [], [CFilter(library, source) for source in sources]
    samples = [
        [rng.normal(size=n) for n in (2, 2, sources[0].n_f)] + [np.eye(2) + 0.1 * rng.normal(size=(2, 2))]
        for _ in range(50)
    ]
    for own in filters:
        answers = [own.step(x, g, f, M if inertia == "full" else None) for x, g, f, M in samples]
        assert not any(code for code, _ in answers)
        results.append([f_hat for _, f_hat in answers])
    np.testing.assert_array_equal(results[0], results[1])
    assert np.abs(results[0]).max() > 0.1
    assert filters[1].size < filters[0].size - 9 * filters[1].dtype.itemsize  # dA alone
    assert filters[1].call("init", np.zeros(1000, np.uint8)) != 0


@pytest.mark.slow
@pytest.mark.parametrize(("real", "tunable"), [("float", False), ("double", True)])
def test_a_step_that_fails_leaves_no_trace(real, tunable, tmp_path):
    sources = diagram_model(flatten(servo()), real=real, tunable=tunable, derivatives=False).sources
    huge = "3e36" if real == "float" else "1e307"
    answer = program(sources, DISTURBED % {"huge": huge}, tmp_path)
    assert answer[0] == "done"
    assert 0.01 < abs(float(answer[1])) < 10.0, "nothing moves, or not as it should"
