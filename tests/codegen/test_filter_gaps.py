"""After a gap every route starts again alike: from the first good sample, with the estimate that it had."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from filter_harness import CFilter, compile_filters
from numpy.typing import NDArray

import phyfilter_ctl as pf
from phyfilter_ctl import PhyFilter, SampledPhyFilter
from phyfilter_ctl.codegen.filter_code import filter_source

FloatArray = NDArray[np.floating]

DT = 0.01
KEEP = pf.LiveRules(missing="keep", clock="keep")  # the estimate is held in a gap, as by all other routes
# Routes sum the same numbers in another order: some hundred roundings of numbers of size 1 over steps of 0.01.
SAME = 1e-9
OPTIONS = [
    {},
    {"g": "average"},
    {"f_theta": "hold"},
    {"delay": 0.017},
    {"method": "euler"},
    {"method": "tustin"},
    {"method": "matched"},
]


class Log(NamedTuple):
    times: FloatArray
    x: FloatArray
    g: FloatArray
    f_theta: FloatArray
    force: FloatArray


def log_of() -> Log:
    """x' = g + f over 8 s: 15 samples bad, 40 samples bad, 0.5 s lost, a clock set one hour ahead, 15 samples lost."""
    n = 800
    t = DT * np.arange(n)
    force = 2.0 + np.sin(3.0 * t)
    g = 5.0 * np.cos(0.7 * t)
    x = 2.0 * t + (1.0 - np.cos(3.0 * t)) / 3.0
    x = x + np.concatenate([[0.0], np.cumsum(DT * g[:-1])])  # g is held
    times = t.copy()
    times[500:] += 3600.0
    x[100:115] = np.nan
    x[200:240] = np.nan
    g[205:230] = np.nan
    kept = np.r_[0:350, 400:600, 615:n]
    f_theta = 0.3 * np.cos(t)
    return Log(*(part[kept] for part in (times, x[:, None], g[:, None], f_theta[:, None], force[:, None])))


def given(log: Log, sampled: SampledPhyFilter) -> FloatArray:
    """g as step by step it is given: that of the sample before where it is held."""
    held = sampled.sampling.g == "hold"
    return np.concatenate([log.g[:1], log.g[:-1]]) if held else log.g


def by_run(sampled: SampledPhyFilter, log: Log) -> FloatArray:
    return sampled.run(log.x, log.g, log.f_theta, times=log.times)


def by_step(sampled: SampledPhyFilter, log: Log) -> FloatArray:
    g0 = None if sampled.sampling.g == "hold" else log.g[0]
    state = sampled.start(log.x[0], f_theta0=log.f_theta[0], g0=g0)
    found = [log.f_theta[0]]
    for k, g in enumerate(given(log, sampled)[1:], 1):
        state, f_hat = sampled.step(
            state, log.x[k], g, log.f_theta[k], dt=float(log.times[k] - log.times[k - 1])
        )
        found.append(f_hat)
    return np.array(found)


def by_live(sampled: SampledPhyFilter, log: Log) -> FloatArray:
    live = sampled.live(1, KEEP)
    rows = zip(log.times.tolist(), log.x, given(log, sampled), log.f_theta, strict=True)
    return np.array([live.step(*row) for row in rows])


def in_c(sampled: SampledPhyFilter, log: Log, library: CFilter) -> FloatArray:
    g0 = None if sampled.sampling.g == "hold" else log.g[0]
    assert library.start(log.x[0], None, log.f_theta[0], None, g0) == 0
    found = [log.f_theta[0]]
    for k, g in enumerate(given(log, sampled)[1:], 1):
        code, f_hat = library.step(log.x[k], g, log.f_theta[k], dt=float(log.times[k] - log.times[k - 1]))
        assert code == 0
        found.append(f_hat)
    return np.array(found)


def two_poles(options: dict[str, object], **more: object) -> SampledPhyFilter:
    return PhyFilter.from_poles([-8.0, -12.0]).sampled(DT, nonfinite="hold", **options, **more)  # pyright: ignore


@pytest.fixture(scope="module")
def libraries(tmp_path_factory: pytest.TempPathFactory) -> list[CFilter]:
    sources = [
        filter_source(two_poles(options), name=f"gap{k}", channels=1, variable=True)
        for k, options in enumerate(OPTIONS)
    ]
    library = compile_filters(sources, tmp_path_factory.mktemp("gaps"))
    return [CFilter(library, source) for source in sources]


@pytest.mark.slow
@pytest.mark.parametrize("k", range(len(OPTIONS)), ids=[str(options) for options in OPTIONS])
def test_c_goes_on_as_the_record_does(k: int, libraries: list[CFilter]) -> None:
    log, sampled = log_of(), two_poles(OPTIONS[k])
    np.testing.assert_allclose(in_c(sampled, log, libraries[k]), by_run(sampled, log), rtol=0.0, atol=SAME)


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_every_route_goes_on_alike_after_gaps_jumps_and_bad_samples(options: dict[str, object]) -> None:
    log = log_of()
    sampled = two_poles(options)
    run = by_run(sampled, log)
    for route in (by_step, by_live):
        np.testing.assert_allclose(route(sampled, log), run, rtol=0.0, atol=SAME)


def test_a_gap_gives_no_jump_of_the_estimate() -> None:
    """The force stays within 1 to 3: no estimate that follows it with lag leaves that by more than rounding."""
    log = log_of()
    f_hat = PhyFilter.from_poles([-8.0]).sampled(DT, nonfinite="hold").run(log.x, log.g, times=log.times)
    after = f_hat[log.times > 2.0]
    assert after.min() > 1.0 - 0.01
    assert after.max() < 3.0 + 0.01


def test_after_a_gap_the_estimate_is_that_of_the_last_good_sample_before_it() -> None:
    log = log_of()
    f_hat = by_run(two_poles({}), log) - log.f_theta
    first = int(np.flatnonzero(np.diff(log.times) > 100.0)[0]) + 1
    assert f_hat[first] == pytest.approx(f_hat[first - 1], abs=1e-12)
    assert f_hat[240] == pytest.approx(f_hat[199], abs=1e-12)
    assert f_hat[115] != pytest.approx(f_hat[99], abs=1e-3)  # 15 samples are closed as one longer step


def test_a_record_that_is_whole_is_run_over_a_gap_alike() -> None:
    """Nothing is missing but time: nonfinite="raise" starts again as "hold" does."""
    log = log_of()
    good = np.isfinite(log.x[:, 0]) & np.isfinite(log.g[:, 0])
    whole = Log(*(part[good] for part in log))
    runs = [
        by_run(PhyFilter.from_poles([-8.0]).sampled(DT, nonfinite=rule), whole) for rule in ("raise", "hold")
    ]
    np.testing.assert_array_equal(runs[0], runs[1])
    found = by_run(PhyFilter.from_poles([-8.0]).sampled(DT), whole)
    assert found[-1, 0] == pytest.approx(whole.force[-1, 0], abs=0.5)


def test_times_in_another_unit_are_no_record_of_gaps() -> None:
    with pytest.raises(ValueError, match=r"times: expected steps of about 0\.01 s.*got 10 s"):
        PhyFilter.from_poles([-8.0]).sampled(DT).run(np.zeros(50), times=10.0 * np.arange(50.0))
