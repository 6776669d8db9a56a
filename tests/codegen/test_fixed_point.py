"""Filters in 32-bit integers: the error within its bound, states within their words, the C equal to its twin."""

import ctypes
import subprocess
from fractions import Fraction
from pathlib import Path

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, export_c, export_target, fixed_point, save, stack
from phyfilter_ctl.analysis.bounds.sampled_kernels import SampledKernels
from phyfilter_ctl.cli import main
from phyfilter_ctl.codegen import find_compiler
from phyfilter_ctl.codegen.compiler import compile_sources
from phyfilter_ctl.codegen.fixed_source import fixed_source

STUBS = Path(__file__).parents[1] / "c" / "stubs" / "arduino"
RANGES = {"x": 8.0, "g": 30.0, "f_theta": 12.0}
SECOND = PhyFilter([400.0, 40.0]).sampled(0.002)
# What a bound is worth that sums magnitudes of errors that partly cancel: measured 4.2 in the median over 72 filters,
# where 1 is the largest error found. The worst ones have coefficients that happen to round well.
MEDIAN_RATIO = 8.0
STRICT = [
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wshadow",
    "-Wconversion",
    "-Wmissing-prototypes",
    "-Wundef",
    "-Werror",
]


def drawn(trial: int):
    """A filter of order 1 to 6 with poles of 3 to 60 rad/s, sampled at 1 to 20 ms, and ranges."""
    rng = np.random.default_rng(trial)
    n, poles = 1 + trial % 6, []
    while len(poles) < n:
        speed, angle = rng.uniform(3.0, 60.0), rng.uniform(1.7, 3.0)
        pair = len(poles) + 2 <= n and rng.random() < 0.5
        poles += [speed * np.exp(1j * angle), speed * np.exp(-1j * angle)] if pair else [-speed]
    filter_ = PhyFilter.from_poles(poles)
    if trial // 6 % 2:
        filter_ = PhyFilter(filter_.a, filter_.a * rng.uniform(0.2, 1.0, n), poles=filter_.poles)
    rules = ("hold", "average")
    sampled = filter_.sampled(
        float(10.0 ** rng.uniform(-3.0, np.log10(2e-2))),
        "tustin" if trial % 5 == 4 else "exact",
        g=rules[trial // 12 % 2],
        f_theta=rules[1 - trial // 24 % 2],
    )
    decades = {"x": (-1.0, 2.0), "g": (0.0, 2.0), "f_theta": (0.0, 1.5)}
    return sampled, {name: float(10.0 ** rng.uniform(*ends)) for name, ends in decades.items()}


def hostile(fixed, count: int):
    """Records over the whole ranges, two channels each of noise, ends alone, waves, and a switch at rest."""
    rng = np.random.default_rng(0)
    k = np.arange(count)[:, None]
    return [
        np.concatenate(
            [
                rng.integers(-most, most + 1, (count, 2)),
                np.where(rng.random((count, 2)) < 0.5, -most, most),
                np.rint(most * np.sin(k * rng.uniform(1e-3, 0.3, 2))).astype(np.int64),
                np.broadcast_to(np.where(k < count // 2, -most, most), (count, 2)),
            ],
            axis=1,
        )
        for most in map(fixed.most, RANGES)
    ]


def worst_error(sampled, ranges, count):
    """Of f_hat against double precision, whose own rounding is a millionth of it; and its bound."""
    fixed = fixed_point(sampled, **ranges)
    record = hostile(fixed, count)
    f_hat, flags = fixed.run(*record)
    assert not flags.any()
    reals = [fixed.reals(name, values) for name, values in zip(RANGES, record, strict=True)]
    return float(np.abs(fixed.reals("f_hat", f_hat) - sampled.run(*reals)).max()), fixed.error_bound


@pytest.mark.parametrize("trial", range(0, 12, 2))
def test_error_stays_within_its_bound(trial):
    worst, bound = worst_error(*drawn(trial), 150)
    assert 0.0 < worst <= bound


@pytest.mark.slow
def test_bound_over_many_filters_and_what_it_is_worth():
    found = np.array([worst_error(*drawn(trial), 1000) for trial in range(72)])
    assert np.all(found[:, 0] <= found[:, 1])
    assert np.median(found[:, 1] / found[:, 0]) < MEDIAN_RATIO


def test_bound_against_exact_arithmetic():
    """Beside rational numbers, from the equations and not from the code."""
    sampled, ranges = drawn(7)
    assert (sampled.sampling.g, sampled.sampling.f_theta) == ("hold", "average")
    fixed = fixed_point(sampled, **ranges)
    rational = np.vectorize(lambda v: Fraction(float(v)), otypes=[object])
    record = [values[:40] for values in hostile(fixed, 40)]
    f_hat = rational(fixed.reals("f_hat", fixed.run(*record)[0]))
    x, g, f_theta = (rational(fixed.reals(name, values)) for name, values in zip(RANGES, record, strict=True))
    dA, rest, C = map(rational, sampled.transition)
    w = rational(np.zeros((len(C), x.shape[1])))
    for k in range(1, 40):
        u = (x[k] - x[k - 1]) / Fraction(sampled.dt) - g[k - 1] - (f_theta[k] + f_theta[k - 1]) / 2
        w = w + dA @ (w - np.multiply.outer(rest, u))
        assert max(abs(f_hat[k] - (f_theta[k] + C @ w))) <= fixed.error_bound


def test_gains_are_the_sums_of_one_pole():
    """w' from u: sum a^i (1 - a) = 1; from x twice the first; an error of w: 1 / (1 - a), its changes twice 1."""
    h, p = 0.01, 20.0
    kernels = SampledKernels(PhyFilter([p]).sampled(h))
    first = -np.expm1(-p * h)
    gains = kernels.state_gains()
    found = [gains.of_u, gains.of_x, gains.to_output, gains.changes, kernels.between_states()[0]]
    assert np.concatenate(found) == pytest.approx(
        [1.0, 2.0 * first / h, 1.0 / first, 2.0, 1.0 / first], rel=1e-7
    )


@pytest.mark.parametrize("trial", [5, 16])
def test_states_fill_their_words_and_no_more(trial):
    """A channel for each state, with the x, g and f_theta that drive it furthest by its impulse response."""
    sampled, ranges = drawn(trial)
    fixed = fixed_point(sampled, **ranges)
    dA, rest, _ = sampled.transition
    count = 500
    course = [rest]
    for _ in range(count):
        course.append(course[-1] + dA @ course[-1])
    impulse = -np.diff(course, axis=0)  # of the states, from u
    sign_x = np.sign(np.diff(impulse, axis=0, prepend=0.0 * impulse[:1]))[::-1]
    sign_u = np.sign(impulse)[::-1]
    x = fixed.most("x") * np.vstack([0.0 * rest, sign_x])
    g = fixed.most("g") * np.vstack([-sign_u, 0.0 * rest])
    f_theta = fixed.most("f_theta") * np.vstack([0.0 * rest, -sign_u])
    _, flags = fixed.run(*(values.astype(np.int64) for values in (x, g, f_theta)))
    assert not flags.any()
    x, g, f_theta = (fixed.reals(name, values) for name, values in zip(RANGES, (x, g, f_theta), strict=True))
    w = np.zeros_like(dA)  # by channel
    for k in range(1, count + 1):
        means = [
            v[k - 1] if rule == "hold" else (v[k] + v[k - 1]) / 2
            for v, rule in ((g, sampled.sampling.g), (f_theta, sampled.sampling.f_theta))
        ]
        u = (x[k] - x[k - 1]) / sampled.dt - means[0] - means[1]
        w += (w - np.multiply.outer(u, rest)) @ dA.T
    filled = np.abs(np.diagonal(w)) * 2.0 ** np.array(fixed.states)
    assert np.all(filled < 2**31)
    assert np.all(filled > 0.9 * 2**30)  # a power of two may be left, and what averages take


def test_what_integers_cannot_do_is_refused_by_name(tmp_path):
    for options, named in (
        ({"delay": 0.004}, "delay"),
        ({"nonfinite": "hold"}, "hold"),
        ({"g_limit": (-1.0, 1.0)}, "g_limit"),
        ({"E": [[1.0], [0.5]]}, "E"),
    ):
        with pytest.raises(ValueError, match=named):
            fixed_point(PhyFilter([20.0]).sampled(0.01, **options), **RANGES)
    with pytest.raises(ValueError, match="several filters"):
        fixed_point(stack([SECOND, PhyFilter([20.0]).sampled(0.002)]), **RANGES)
    with pytest.raises(ValueError, match="x: expected"):
        fixed_point(SECOND, x=0.0)
    with pytest.raises(ValueError, match="take a shorter step"):
        fixed_point(SECOND, x=1e-9, g=1e9)
    with pytest.raises(TypeError, match="integers"):
        fixed_point(SECOND, **RANGES).run([[0.5]])
    with pytest.raises(ValueError, match="one shape"):
        fixed_point(SECOND, **RANGES).run([[1], [2]], [[1]])
    for values in (np.array([[2**31]]), np.array([[2**63]], dtype=np.uint64), np.zeros((0, 1), dtype=int)):
        with pytest.raises(ValueError, match="one sample of 32 bits or more"):
            fixed_point(SECOND, **RANGES).run(values)
    with pytest.raises(ValueError, match="g: expected numbers, got nan"):
        fixed_point(SECOND, **RANGES).integers("g", [1.0, np.nan])
    lag = ct.tf([1.0], [1.0, 1.0], inputs="u", outputs="y", name="lag")
    for system, options, named in (
        (lag, {"real": "q31", "ranges": RANGES}, "a diagram"),
        (SECOND, {"real": "q31"}, "ranges"),
        (SECOND, {"real": "float", "ranges": RANGES}, "ranges"),
        (SECOND, {"real": "q31", "ranges": {"g": 1.0}}, "expected x"),
        (SECOND, {"real": "q31", "ranges": RANGES, "inertia": 2.0}, "inertia"),
    ):
        with pytest.raises(ValueError, match=named):
            export_c(system, tmp_path / "no", **options)
    with pytest.raises(ValueError, match="zephyr"):
        export_target(SECOND, "zephyr", tmp_path / "no", real="q31", ranges=RANGES)
    assert not (tmp_path / "no").exists()


def test_inputs_beyond_their_ranges_saturate_and_are_said():
    fixed = fixed_point(PhyFilter([20.0]).sampled(0.01, limit=3.0), **RANGES)
    x, g, f_theta = (np.zeros((4, 1), dtype=np.int64) for _ in range(3))
    x[1], g[1], f_theta[2] = fixed.most("x") + 1, fixed.most("g") + 1, -fixed.most("f_theta") - 1
    f_hat, flags = fixed.run(x, g, f_theta)
    assert (flags & 7).tolist() == [0, 1, 2 + 4, 0]  # a held g when it acts
    at = [fixed.most("x"), fixed.most("g"), -fixed.most("f_theta")]
    x[1], g[1], f_theta[2] = at
    again, flags = fixed.run(x, g, f_theta)
    assert np.array_equal(f_hat, again)
    assert flags[1] == 16
    assert np.abs(fixed.reals("f_hat", f_hat)).max() <= 3.0


@pytest.mark.parametrize(
    ("options", "ranges"),
    [
        ({}, {"x": 1e-3}),
        ({"limit": 5.0}, {"x": 1.0, "g": 6000.0, "f_theta": 2000.0}),
        ({"limit": 1e-3}, {"x": 1.0, "f_theta": 500.0}),
    ],
)
def test_sums_fit_where_f_theta_is_nothing_or_far_beyond_the_limit(options, ranges):
    """A filter of hardly any gain, whose coefficients leave the most bits to the sum."""
    filter_ = PhyFilter([400.0, 40.0], [0.04, 0.004])
    fixed = fixed_point(filter_.sampled(0.01, **options), **ranges)
    most = fixed.most("f_theta")
    largest = (most << fixed.shifts["f_theta"]) + int(np.abs(fixed.C).sum()) * (2**31 - 1)
    assert fixed.shifts["f_theta"] <= 62
    assert largest + (1 << (fixed.shifts["C"] - 1)) < 2**63
    ends = np.array([[most], [-most]])
    f_hat = fixed.reals("f_hat", fixed.run(0 * ends, f_theta=ends)[0])
    assert np.array_equal(np.sign(f_hat), np.sign(ends))


@pytest.mark.slow
def test_the_command_writes_a_program_that_checks_itself(tmp_path):
    save(tmp_path / "filter.toml", SECOND)
    words = f"export {tmp_path}/filter.toml --c {tmp_path}/out --channels 2 --name wing --real q31"
    assert main(words.split()) != 0
    assert main(f"{words} --ranges x=8 g=30 f_theta=12".split()) == 0
    files = {path.name: path.read_text() for path in (tmp_path / "out").iterdir()}
    assert f"<= {fixed_point(SECOND, **RANGES).error_bound:.3g}" in files["wing.h"]
    program = compile_sources(files, tmp_path / "wing", kind="program", flags=STRICT)
    answer = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout
    files["wing.c"] = files["wing.c"].replace(".of_g = ", ".of_g = 1 + ")
    program = compile_sources(files, tmp_path / "damaged", kind="program", flags=STRICT)
    answer = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert answer.returncode == 1
    assert "init 64" in answer.stdout  # the CRC


def library(fixed, folder, channels, checked, *more):
    """Of one filter; ``checked``: an overflow or another undefined operation ends the process, where gcc can."""
    files = fixed_source(fixed, channels, name="wing")
    files["size.c"] = (
        '#include "wing.h"\nunsigned wing_size(void);\nunsigned wing_size(void) { return sizeof(wing); }\n'
    )
    del files["main.c"]
    gcc = "clang" not in find_compiler().version.lower() and find_compiler().command[-1] in ("cc", "gcc")
    checks = ["-fsanitize=undefined", "-fno-sanitize-recover"] if checked and gcc else []
    flags = [*STRICT, "-fvisibility=default", *checks, *more]
    return ctypes.CDLL(str(compile_sources(files, folder / "wing.so", flags=flags)))


@pytest.mark.slow
@pytest.mark.parametrize("trial", [0, 1, 8, 15, 22, 28, 29, 35])
def test_c_is_its_twin_to_the_bit(trial, tmp_path):
    """Odd ones with the product of cores that have none of 64 bits."""
    sampled, ranges = drawn(trial)
    fixed = fixed_point(sampled, **ranges)
    c = library(fixed, tmp_path, 8, trial < 2, *(["-D__ARM_ARCH_6M__"] if trial % 2 else []))
    pointer = ctypes.c_void_p(ctypes.addressof(ctypes.c_char.in_dll(c, "wing_parameters")))
    memory = ctypes.create_string_buffer(c.wing_size())
    x, g, f_theta = hostile(fixed, 700)
    x[200] = 2**31 - 1  # out of range
    f_hat, flags = fixed.run(x, g, f_theta)
    given = np.roll(g, 1, axis=0) if sampled.sampling.g == "hold" else g
    assert c.wing_init(memory, pointer) == 0
    out = np.zeros(x.shape[1], np.int32)
    for k in range(len(x)):
        arrays = [np.ascontiguousarray(values[k], np.int32) for values in (x, given, f_theta)]
        code = c.wing_step(memory, *(ctypes.c_void_p(a.ctypes.data) for a in (*arrays, out)))
        assert code == flags[k]
        assert np.array_equal(out, f_hat[k])


@pytest.mark.slow
def test_jumps_of_x_leave_no_trace_and_damage_saturates(tmp_path):
    c = library(fixed_point(SECOND, **RANGES), tmp_path, 2, True)
    parameters = ctypes.c_void_p(ctypes.addressof(ctypes.c_char.in_dll(c, "wing_parameters")))
    memory = ctypes.create_string_buffer(c.wing_size())
    most = 2**29
    pair, zero, out = (ctypes.c_int32 * 2), (ctypes.c_int32 * 2)(), (ctypes.c_int32 * 2)()
    assert c.wing_step(memory, zero, zero, zero, out) == 128
    assert c.wing_init(memory, parameters) == 0
    assert c.wing_step(memory, zero, zero, zero, out) == 0
    assert c.wing_shift_x(memory, pair(most, -most)) == 0
    assert c.wing_step(memory, pair(most, -most), zero, zero, out) == 0
    assert list(out) == [0, 0]
    said = 0
    for _ in range(400):  # x runs up for ever, jump by jump
        c.wing_shift_x(memory, pair(-2 * most, 0))
        said |= c.wing_step(memory, pair(most, 0), zero, zero, out)
    assert said & 8
    c.wing_reset(memory)
    assert c.wing_step(memory, pair(most, 0), zero, pair(7, 8), out) == 0


@pytest.mark.slow
@pytest.mark.parametrize("target", ["arduino", "cmake"])
def test_packages(target, tmp_path):
    folder = export_target(
        SECOND, target, tmp_path / target, channels=2, name="wing", real="q31", ranges=RANGES
    )
    text = (folder / "README.md").read_text()
    assert "wing_step(&filter" in text or target == "arduino"
    assert not list(folder.rglob("*guard*"))
    include = ["-I", str(folder / "src")]
    sources = [str(path) for path in (folder / "src").glob("*.c")]
    command, program = [*find_compiler().command, *STRICT, *include], str(tmp_path / "program")
    if target == "cmake":
        test = str(folder / "test" / "main.c")
        subprocess.run([*command, "-std=c99", *sources, test, "-o", program], check=True)
        subprocess.run([program], check=True)
        return
    (sketch,) = folder.glob("examples/*/*.ino")
    loops = "int main() { setup(); for (int i = 0; i < 99; i++) loop(); }\n"
    (tmp_path / "main.cpp").write_text(f'#include "Arduino.h"\n#include "{sketch}"\n{loops}')
    subprocess.run([*command, "-std=gnu99", "-c", *sources], check=True, cwd=tmp_path)
    cpp = [*find_compiler().command, "-Wall", "-Wextra", "-Werror", "-I", str(STUBS), *include]
    subprocess.run([*cpp, str(tmp_path / "main.cpp"), str(tmp_path / "wing.o"), "-o", program], check=True)
    lines = subprocess.run([program], check=True, capture_output=True, text=True).stdout.splitlines()
    assert lines[-1] == "0 0 0"
