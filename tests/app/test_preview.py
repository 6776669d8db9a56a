"""The designer's preview in the browser, run by node, against the library and against arithmetic of 60 digits."""

from __future__ import annotations

import itertools
import json
import math
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

from phyfilter_ctl import PhyFilter
from phyfilter_ctl._sections import expm1
from phyfilter_ctl.analysis import frequency_response
from phyfilter_ctl.app import loop_views
from phyfilter_ctl.app.answers import settling_time
from phyfilter_ctl.app.checking import Fields
from phyfilter_ctl.app.designs import read_design
from phyfilter_ctl.app.modules import WEB
from phyfilter_ctl.filter import SampledPhyFilter

NODE = shutil.which("node") or shutil.which("node", path=str(Path(sys.executable).parent))
pytestmark = pytest.mark.skipif(NODE is None, reason="node is not installed")

# What the preview promises, relative to the largest value of a curve.
AGREES = 1e-9
# Roots of N by two iterations of their own; simple ones here, relative to their size.
ROOTS = 1e-7
# Unwrapped phase in degrees, where |F| is not lost in rounding.
PHASE = 1e-6
DIGITS = 60
POINTS = 120
# Poles within this many decades. At four the noise gain of forward Euler, order 7 and 8, has lost digits in the preview
# (2e-9) and in the library (5e-9); all else agrees to 4e-12 there too.
DECADES = 3.0

Pair = list[float]


class Case(NamedTuple):
    """A design, what node is asked about it, and the library's filters."""

    question: dict[str, Any]
    filter: PhyFilter
    sampled: SampledPhyFilter


def ask(questions: Sequence[dict[str, Any]]) -> list[Any]:
    assert NODE is not None
    command = [NODE, str(Path(__file__).with_name("preview.mjs")), str(WEB)]
    done = subprocess.run(
        command, input=json.dumps(questions), capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def call(name: str, *given: object) -> Any:
    return ask([{"call": name, "given": list(given)}])[0]


def pole_set(rng: np.random.Generator, base: float, order: int, kind: int, decades: float) -> list[Pair]:
    """One repeated pole (kind 0), distinct ones (1), or pairs that repeat (2)."""

    def size() -> float:
        return float(base * 10.0 ** rng.uniform(-decades / 2.0, decades / 2.0))

    if kind == 0:
        return [[-base, 0.0]] * order
    poles: list[Pair] = []
    while len(poles) < order:
        if order - len(poles) >= 2 and rng.random() < 0.5:
            damping, natural = float(10.0 ** rng.uniform(-1.5, -0.05)), size()
            swing = natural * math.sqrt(1.0 - damping**2)
            pair = [[-damping * natural, swing], [-damping * natural, -swing]]
            poles += pair * 2 if kind == 2 and order - len(poles) >= 4 else pair
        else:
            poles.append([-size(), 0.0])
    return poles


def numerator(rng: np.random.Generator, poles: list[Pair], base: float) -> dict[str, Any]:
    order = len(poles)
    kind = ("lowpass", "type", "zeros", "b")[int(rng.integers(4))]
    if kind == "lowpass":
        return {"kind": kind}
    if kind == "type":
        return {"kind": kind, "type": int(rng.integers(1, order + 1))}
    if kind == "b":
        a = PhyFilter.from_poles([complex(*p) for p in poles]).a
        return {"kind": kind, "b": (a * rng.normal(size=order)).tolist()}
    zeros: list[Pair] = []
    for _ in range(int(rng.integers(0, order))):
        if rng.random() < 0.3 and len(zeros) + 2 < order:
            pair = [float(base * rng.normal()), float(base * rng.uniform(0.2, 2.0))]
            zeros += [pair, [pair[0], -pair[1]]]
        elif len(zeros) + 1 < order:
            zeros.append([float(base * rng.choice([-1.7, -0.4, 0.0, 0.6])), 0.0])
    gain = float(base ** (order - len(zeros)) * rng.uniform(0.2, 2.0))
    return {"kind": kind, "zeros": zeros, "gain": gain}


def around(rng: np.random.Generator, dt: float) -> dict[str, float]:
    """Lag, delay and ratio of the loop: none, parts of a step, many steps, and so many that it counts as continuous."""
    lag = float(rng.choice([0.0, 0.02 * dt, dt, 60.0 * dt]))
    delay = float(rng.choice([0.0, 0.3, 3.0, 7.6, 80.0]) * dt)
    return {"lag": min(lag, 10.0), "delay": min(delay, 10.0), "ratio": float(10.0 ** rng.uniform(-1.0, 1.0))}


def case(
    rng: np.random.Generator, order: int, *, kind: int = 1, method: str = "exact", decades: float = DECADES
) -> Case:
    base = float(10.0 ** rng.uniform(-3.0 + decades, 5.0 - decades))
    poles = pole_set(rng, base, order, kind, decades)
    sizes = [math.hypot(*p) for p in poles]
    limit = min(-2.0 * re / (re * re + im * im) for re, im in poles)
    longest = 0.9 * limit if method == "euler" else 0.3 / min(sizes)
    dt = float(np.clip(longest * 10.0 ** rng.uniform(-2.0, 0.0), 1e-5, 1.0))
    if method == "euler" and dt >= longest:  # poles too fast for the shortest step
        method = "tustin"
    design = {
        "poles": poles,
        "numerator": numerator(rng, poles, base),
        "sampling": {"dt": dt, "method": method},
        "assume": around(rng, dt),
    }
    read = read_design(Fields({"design": design}))
    omega = np.geomspace(min(sizes) / 30.0, max(sizes) * 30.0, POINTS)
    below = np.geomspace(min(min(sizes), 1.0 / dt) / 30.0, math.pi / dt, POINTS)
    question = {
        "design": design,
        "omega": omega.tolist(),
        "below": below.tolist(),
        "loop": loop_views.loop(read)["omega"],
        "duration": 12.0 / min(-re for re, _ in poles),
        "points": POINTS,
    }
    return Case(question, read.filter, read.sampled)


def every_case() -> list[Case]:
    rng = np.random.default_rng(9)
    methods = ("exact", "euler", "tustin", "matched")
    return [
        case(rng, order, kind=kind, method=method)
        for order in range(1, 9)
        for kind in range(3)
        for method in methods
    ]


@pytest.fixture(scope="module")
def answered() -> list[tuple[Case, dict[str, Any]]]:
    cases = every_case()
    return list(zip(cases, ask([each.question for each in cases]), strict=True))


def curve(values: Sequence[Sequence[float]]) -> NDArray[np.complex128]:
    return np.array(values[0]) + 1j * np.array(values[1])


def relative(found: NDArray[Any], expected: NDArray[Any]) -> float:
    return float(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))


Answered = list[tuple[Case, dict[str, Any]]]


def test_coefficients_and_type_are_the_library_s(answered: Answered) -> None:
    for (_, filter, _), answer in answered:
        scale = filter.a ** (1.0 / np.arange(filter.order, 0, -1))
        power = np.max(scale) ** np.arange(filter.order, 0, -1)
        assert np.max(np.abs(np.array(answer["a"]) / filter.a - 1.0)) < AGREES
        assert np.max(np.abs((np.array(answer["b"]) - filter.b) / power)) < AGREES
        assert np.max(np.abs((np.array(answer["c"])[:-1] - filter.error_numerator[:-1]) / power)) < AGREES
        assert answer["type"] == filter.type


def test_the_loop_s_gains_are_the_library_s(answered: Answered) -> None:
    seen = set()
    for each, answer in answered:
        expected = loop_views.loop(read_design(Fields({"design": each.question["design"]})))
        seen.add((expected["note"], each.question["design"]["assume"]["lag"] > 0.0))
        L, S, T = (curve(expected[key]) for key in ("L", "S", "T"))  # type: ignore[arg-type]  # two lists of numbers
        found = [curve(value) for value in answer["loop"]]
        assert relative(found[1], S) < AGREES
        assert relative(found[2], T) < AGREES
        # On the sphere: an L that ends in an integrator has no largest value.
        assert np.max(np.abs(found[0] - L) / (1.0 + np.abs(L)) ** 2) < AGREES
    assert len(seen) == 4


def test_the_random_designs_hold_every_kind_and_repeated_poles() -> None:
    cases = every_case()
    kinds = {each.question["design"]["numerator"]["kind"] for each in cases}
    assert kinds == {"lowpass", "type", "zeros", "b"}
    assert {each.sampled.sampling.method for each in cases} == {*("exact", "matched", "euler", "tustin")}
    repeated = [each for each in cases if len(np.unique(each.filter.poles)) < each.filter.order]
    assert {each.filter.order for each in repeated} == set(range(2, 9))
    twice = [each for each in repeated if np.any(each.filter.poles.imag)]
    assert {each.filter.order for each in twice} >= {5, 6, 7, 8}


def test_f_and_error_are_the_library_s(answered: Answered) -> None:
    for (question, filter, _), answer in answered:
        s = 1j * np.array(question["omega"])
        assert relative(curve(answer["F"]), filter(s)) < AGREES
        assert relative(curve(answer["E"]), filter.error(s)) < AGREES


def test_phase_is_unwrapped(answered: Answered) -> None:
    for (question, filter, _), answer in answered:
        F = filter(1j * np.array(question["omega"]))
        assert np.max(np.abs(np.array(answer["phase"]) - np.rad2deg(np.unwrap(np.angle(F))))) < PHASE


def test_sampled_f_and_error_are_the_library_s(answered: Answered) -> None:
    for (question, _, sampled), answer in answered:
        response = frequency_response(sampled, question["below"])
        assert relative(curve(answer["S"]), response.F) < AGREES
        assert relative(curve(answer["SE"]), response.error) < AGREES


def test_step_response_is_the_library_s(answered: Answered) -> None:
    for (_, filter, _), answer in answered:
        A, equilibrium, C = filter.sections
        t = np.array(answer["t"])
        expected = np.array([0.0, *(-expm1(A, t[1:]) @ equilibrium @ C)])
        assert relative(np.array(answer["step"]), expected) < AGREES
        assert relative(np.array(answer["stepError"]), 1.0 - expected) < AGREES


def test_figures_are_the_library_s(answered: Answered) -> None:
    for (_, filter, sampled), answer in answered:
        response = frequency_response(sampled, [1.0 / sampled.dt])
        assert answer["noiseGain"] == pytest.approx(response.noise_gain, rel=AGREES)
        limit = float(np.min(-2.0 * filter.poles.real / np.abs(filter.poles) ** 2))
        assert answer["eulerLimit"] == pytest.approx(limit, rel=AGREES)
        bandwidth = frequency_response(filter).bandwidth
        assert (answer["bandwidth"] is None) == (not np.isfinite(bandwidth))
        if filter.is_lowpass or filter.order == 1:
            assert answer["bandwidth"] == pytest.approx(bandwidth, rel=AGREES)


def test_settling_time_is_near_the_library_s(answered: Answered) -> None:
    near = 0.01  # both interpolate on a grid
    for (_, filter, _), answer in answered:
        if filter.is_lowpass:
            assert answer["settling"] == pytest.approx(settling_time(filter), rel=near)


def test_zeros_are_the_roots_of_the_numerator(answered: Answered) -> None:
    for (question, filter, _), answer in answered:
        if question["design"]["numerator"]["kind"] == "zeros":
            continue
        found = np.array([complex(*zero) for zero in answer["zeros"]])
        assert len(found) == len(filter.zeros)
        for zero in filter.zeros:
            assert np.min(np.abs(found - zero)) < ROOTS * abs(zero)


# -- matched sampling, where there is something to keep ----------------------------------------------------------


def with_zeros(rng: np.random.Generator, each: Case) -> dict[str, Any]:
    """The design with s^k (s^2 + w^2) ... as the numerator of 1 - F."""
    a, sizes = each.filter.a, np.abs(each.filter.poles)
    w = min(0.5 * math.pi / each.sampled.dt, float(rng.uniform(sizes.min(), sizes.max())))
    type = int(rng.integers(0, len(a) - 1))
    error = np.array([w * w, 0.0, 1.0])
    for size in sizes[: len(a) - type - 2]:
        error = np.convolve(error, [size, 1.0])
    b = np.array(a)
    b[type:] -= error[:-1]
    return each.question["design"] | {"numerator": {"kind": "b", "b": b.tolist()}}


@pytest.mark.slow
def test_what_matched_sampling_keeps_is_the_library_s() -> None:
    rng, questions, expected = np.random.default_rng(4), [], []
    for order, kind in itertools.product(range(2, 9), range(3)):
        plain = case(rng, order, kind=kind, method="matched")
        followed = plain.question["design"] | {
            "numerator": {"kind": "type", "type": int(rng.integers(2, order + 1))}
        }
        for design in (followed, with_zeros(rng, plain)):
            read = read_design(Fields({"design": design}))
            questions.append(plain.question | {"design": design})
            expected.append(read.sampled)
    assert sum(sampled.sampling.method == "matched" for sampled in expected) > 0.8 * len(expected)
    for question, answer, sampled in zip(questions, ask(questions), expected, strict=True):
        response = frequency_response(sampled, question["below"])
        assert relative(curve(answer["S"]), response.F) < AGREES
        assert relative(curve(answer["SE"]), response.error) < AGREES
        assert answer["noiseGain"] == pytest.approx(response.noise_gain, rel=AGREES)


@pytest.mark.slow
def test_what_cannot_be_matched_is_sampled_exactly() -> None:
    """1 - F = s (s^2 + w^2) / D with w beyond Nyquist; and a type of 8 with poles far too fast for the step."""
    slow = {"poles": [[-100.0, 0.0]] * 3, "numerator": {"kind": "b", "b": [1e6, 3e4 - 200.0**2, 300.0]}}
    fast = {
        "poles": [[-(10.0 ** (0.5 * k)), 0.0] for k in range(8)],
        "numerator": {"kind": "type", "type": 8},
    }
    for design, dt, words in (
        (slow, 0.02, "beyond the Nyquist frequency"),
        (fast, 0.02, "too long for poles"),
    ):
        known, exact = (design | {"sampling": {"dt": dt, "method": m}} for m in ("matched", "exact"))
        read = read_design(Fields({"design": known}))
        assert (read.sampled.sampling.method, words in read.unmatched) == ("exact", True)
        question = {"omega": [1.0], "below": [1.0, 100.0], "duration": 1.0, "points": 3}
        first, second = ask([question | {"design": each} for each in (known, exact)])
        assert (first["S"], first["noiseGain"]) == (second["S"], second["noiseGain"])
        known["sampling"]["dt"] = 1e-4 if design is slow else 1e-5
        assert read_design(Fields({"design": known})).sampled.sampling.method == "matched"


# -- where the time scales are decades apart: arithmetic of many digits is the judge ----------------------------


def sampled_by_many_digits(each: Case) -> tuple[NDArray[np.complex128], float]:
    """Sampled F and noise gain of the exact method from the companion form, with no section and no delta form."""
    filter, dt, n = each.filter, mp.mpf(each.sampled.dt), each.filter.order
    product = [mp.mpc(1)]
    for pole in filter.poles:
        shifted = [mp.mpc(0), *product]
        product = [
            high - mp.mpc(complex(pole)) * low for high, low in zip(shifted, [*product, 0], strict=True)
        ]
    A = mp.zeros(n, n)
    for i in range(n - 1):
        A[i, i + 1] = 1
    for j in range(n):
        A[n - 1, j] = -mp.re(product[j])
    B = mp.zeros(n, 1)
    B[n - 1] = 1
    C = mp.matrix([[mp.mpf(float(b)) for b in filter.b]])
    step = mp.expm(A * dt)
    drive = mp.lu_solve(A, (step - mp.eye(n)) * B)
    values = []
    for omega in each.question["below"]:
        half = mp.mpf(omega) * dt / 2
        z = mp.expj(2 * half)
        gain = (C * mp.lu_solve(z * mp.eye(n) - step, drive))[0] * z
        values.append(complex(gain * mp.sin(half) / half * mp.expj(-half)))
    # u_k = (nu_k - nu_{k-1})/h: the state less drive nu_k / h is driven by (step - I) drive nu_{k-1} / h.
    entry = (step - mp.eye(n)) * drive / dt
    P, power = entry * entry.T, step
    for _ in range(64):
        added = power * P * power.T
        P, power = P + added, power * power
        if mp.norm(added) < mp.mpf(10) ** -40 * mp.norm(P):
            break
    direct = (C * drive)[0] / dt
    return np.array(values), float(mp.sqrt((C * P * C.T)[0] + direct**2))


@pytest.mark.parametrize("order", [3, 5, 8])
def test_poles_decades_apart_lose_no_digits(order: int) -> None:
    rng = np.random.default_rng(order)
    apart = [case(rng, order, decades=3.0) for _ in range(2)]
    for each in apart:
        each.question["below"] = each.question["below"][::12]
    answers = ask([each.question for each in apart])
    with mp.workdps(DIGITS):
        for each, answer in zip(apart, answers, strict=True):
            F, gain = sampled_by_many_digits(each)
            assert relative(curve(answer["S"]), F) < AGREES
            assert answer["noiseGain"] == pytest.approx(gain, rel=AGREES)


# -- what a gesture does to poles and zeros -----------------------------------------------------------------------


def test_a_pair_that_meets_the_axis_splits_and_two_real_poles_join() -> None:
    pair = [{"id": 901, "re": -3.0, "im": 4.0}, {"id": 902, "re": -9.0, "im": 0.0}]
    split = call("moved", pair, 901, {"re": -5.0, "im": 0})
    assert [(root["re"], root["im"]) for root in split] == [(-5.0, 0), (-5.0, 0), (-9.0, 0)]
    assert split[0]["id"] == 901
    joined = call("moved", split, 901, {"re": -5.0, "im": 2.0}, split[1]["id"])
    assert [(root["id"], root["re"], root["im"]) for root in joined] == [(901, -5.0, 2.0), (902, -9.0, 0)]
    alone = call("moved", split, 901, {"re": -6.0, "im": 2.0}, None)
    assert (alone[0]["re"], alone[0]["im"]) == (-6.0, 0)


def test_poles_are_held_in_the_left_half_plane_and_in_range() -> None:
    wanted = ((5.0, 3.0), (0.0, 0.0), (-1e-9, 0.0), (-1e9, 1e9), (1.0, -7.0), (-1e-5, 1e4))
    for held in ask([{"call": "heldPole", "given": pole} for pole in wanted]):
        assert held["re"] < 0.0
        assert held["im"] >= 0.0
        assert 1e-3 * (1.0 - AGREES) <= math.hypot(held["re"], held["im"]) <= 1e5 * (1.0 + AGREES)
    assert call("heldPole", -2.0, 1.5) == {"re": -2.0, "im": 1.5}


def test_scaling_is_time_running_faster() -> None:
    rng = np.random.default_rng(3)
    cases = [case(rng, 1 + i % 8, kind=i % 3) for i in range(16)]
    made = ask([{"call": "scaled", "given": [each.question["design"], 1.7]} for each in cases])
    for each, design in zip(cases, made, strict=True):
        filter = read_design(Fields({"design": {**each.question["design"], **design}})).filter
        s = 1.7j * np.array(each.question["omega"])
        assert relative(filter(s), each.filter.faster(1.7)(s)) < AGREES


def test_the_gain_is_kept_when_zeros_move() -> None:
    poles = [[-3.0, 4.0], [-3.0, -4.0], [-8.0, 0.0]]
    roots = [complex(*p) for p in poles]
    gain = call("gainFor", poles, [[-2.0, 0.0]], 1.0)
    assert PhyFilter.from_poles(roots, [2.0 * gain, gain, 0.0]).dc_gain == pytest.approx(1.0, rel=AGREES)
    gain = call("gainFor", poles, [[0.0, 0.0]], 0.5)
    middle = 200.0 ** (1.0 / 3.0)
    assert abs(PhyFilter.from_poles(roots, [0.0, gain, 0.0])(1j * middle)) == pytest.approx(0.5, rel=AGREES)


def test_typed_numbers() -> None:
    expected = {
        "12": 12.0,
        " -1.5e-3 ": -1.5e-3,
        "−4": -4.0,
        "0,25": 0.25,
        ".5": 0.5,
        "1e": None,
        "": None,
        "0x10": None,
    }
    assert ask([{"call": "typed", "given": [text]} for text in expected]) == list(expected.values())


def test_short_numbers() -> None:
    expected = {
        12.3456: "12.35",
        -0.5: "−0.5",
        1.5e-5: "1.5e−5",
        2e7: "2e7",
        0.0: "0",
        None: "–",
        100.0: "100",
    }
    assert ask([{"call": "short", "given": [value]} for value in expected]) == list(expected.values())


def test_units_that_read_well() -> None:
    questions = [{"call": "inUnit", "given": [value, "s"]} for value in (0.0125, 3e-5, 2.5, 0.0)]
    assert ask(questions) == [["12.5", "ms"], ["30", "µs"], ["2.5", "s"], ["0", "s"]]
    assert call("inUnit", 0.0138642, "m", 3) == ["0.0139", "m"]
