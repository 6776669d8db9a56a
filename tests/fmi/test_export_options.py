"""Every option of the sampled filter acts in its FMU as in Python: the matrix, each option met with several others."""

import numpy as np
import pytest
from exported_fmus import PERIOD, Instance, closed_loop, described, exported, quick_compiler
from fmpy.validation import validate_fmu

import phyfilter_ctl as pf
from phyfilter_ctl.fmi import FmuPorts
from phyfilter_ctl.fmi.export import export_fmu
from tests.cpu_budget import slow_but

N = 160
# The same sums in another order, of numbers of size 1 to 30; a delay adds averages over parts of steps.
AGREE = 1e-11
# A loop in float32 and a record whose states are in double differ by a few roundings of f_hat.
AGREE_FLOAT32 = 2e-6

LOWPASS = pf.PhyFilter.from_poles([-20.0, -5 + 8j, -5 - 8j])
GENERAL = pf.PhyFilter(LOWPASS.a, [LOWPASS.a[0], 0.7 * LOWPASS.a[1], 12.0], poles=LOWPASS.poles)
BANDPASS = pf.PhyFilter(LOWPASS.a, [0.0, LOWPASS.a[1], 3.0], poles=LOWPASS.poles)
SLOW = pf.PhyFilter([3.0])
DIRECTION = [[1.0, 0.5], [0.0, 1.0], [-0.3, 2.0]]
MASSES = [1.2, 0.8, 2.0]
FULL = [[1.2, 0.1, 0.0], [0.1, 0.8, 0.2], [0.0, 0.2, 2.0]]

CASES = {
    "general": (GENERAL, {}, None),
    "band": (BANDPASS, {"g": "average", "f_theta": "hold"}, "scalar"),
    "euler": (LOWPASS, {"method": "euler", "f_theta": "hold"}, "diagonal"),
    "tustin": (GENERAL, {"method": "tustin", "g": "average"}, MASSES),
    "direction": (LOWPASS, {"E": DIRECTION, "g": "average"}, "full"),
    "direction and limit": (BANDPASS, {"E": DIRECTION, "limit": [0.3, 1.0], "method": "tustin"}, FULL),
    "limit": (GENERAL, {"limit": 0.5, "f_theta": "hold"}, "scalar"),
    "whole delay": (GENERAL, {"delay": 3 * PERIOD, "g": "average"}, None),
    "delay": (LOWPASS, {"delay": 2.55 * PERIOD, "method": "euler"}, "full"),
    "delay and direction": (BANDPASS, {"delay": 0.4 * PERIOD, "E": DIRECTION, "f_theta": "hold"}, "diagonal"),
    "one filter a channel": ([SLOW, GENERAL, LOWPASS], {"g": "average"}, MASSES),
    "float32": (GENERAL, {"precision": "float32", "limit": 2.0}, "diagonal"),
    "held": (LOWPASS, {"nonfinite": "hold", "g": "average"}, "scalar"),
    "held and late": (GENERAL, {"nonfinite": "hold", "delay": 1.5 * PERIOD}, None),
}


@pytest.mark.parametrize("case", slow_but(("direction and limit",), CASES))
def test_options_are_those_of_python(case, tmp_path):
    filters, options, inertia = CASES[case]
    filters = filters if isinstance(filters, list) else [filters]
    options = dict(options)
    E = options.pop("E", None)
    sampled = pf.SampledPhyFilter(filters, pf.Sampling(PERIOD, **options), E=E)
    rng = np.random.default_rng(4)
    n_f = 3 if E is None else 2
    x = 0.02 * np.cumsum(rng.standard_normal((N, 3)), axis=0)
    g, f_theta = rng.standard_normal((N, 3)), rng.standard_normal((N, n_f))
    M = np.eye(3) + 0.1 * rng.standard_normal((N, 3, 3))
    diagonal = M[:, [0, 1, 2], [0, 1, 2]]
    given, value = {
        "scalar": (diagonal[:, :1], diagonal[:, :1] * np.ones(3)),
        "diagonal": (diagonal, diagonal),
        "full": (M.reshape(N, 9), M),
    }.get(inertia if isinstance(inertia, str) else "", (None, inertia))
    if options.get("nonfinite") == "hold":
        x[40], x[60:64, 1], g[90], f_theta[120, 0] = np.nan, np.inf, np.nan, np.nan
    fmi = "2.0" if list(CASES).index(case) % 2 else "3.0"
    path = export_fmu(
        sampled,
        tmp_path / "a.fmu",
        fmi=fmi,
        name="options",
        compiler=quick_compiler(),
        ports=FmuPorts(channels=3, inertia=inertia),
    )
    expected = sampled.run(x, g, f_theta, inertia=value)
    with Instance(path) as fmu:
        extra = {} if given is None else {"M": given[0]}
        fmu.start(x=x[0], g=g[0], f_theta=f_theta[0], **extra)
        found = [fmu.get("f_hat")]
        for k in range(1, N):
            extra = {} if given is None else {"M": given[k]}
            # A held g is the one of the step that ends now: what run calls row k - 1 is remembered by the FMU.
            fmu.step(PERIOD, x=x[k], g=g[k], f_theta=f_theta[k], **extra)
            found.append(fmu.get("f_hat"))
    tolerance = AGREE if sampled.sampling.precision == "float64" else 50 * AGREE_FLOAT32
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_recorded_signals_are_those_of_the_simulation(fmi):
    """Outputs and inputs of blocks as local variables, in both kinds; what was there before stays as it was."""
    inside = ("plant.thrust", "law.u", "observer.f_hat[0]", "observer.x[0]")
    path = exported(
        "loop", fmi, ports=FmuPorts(record=("plant.thrust", "law.?", "observer.*[0]"), clocks=fmi == "3.0")
    )
    bare = {v.name for v in described(exported("loop", fmi)).modelVariables}
    found = {v.name: v for v in described(path).modelVariables}
    assert {found[name].causality for name in inside} == {"local"}
    more = {n for n in found if not n.startswith("clock.")} - bare
    own = {f"observer.{signal}[0]" for signal in ("x", "g", "f_theta", "f_hat")}
    assert more == {"law.u", "law.s", "law.v", "plant.thrust"} | own
    assert bare <= set(found)
    assert validate_fmu(str(path)) == []
    times = np.arange(41) * 0.005
    flat = pf.diagram.flatten(closed_loop(), record=inside)
    assert [v.name for v in flat.outputs] == ["s", "v", "f_hat", *inside]
    expected = pf.simulate(flat, times, np.tile([[1.0], [0.1]], len(times)), method="rk4", max_step=1e-3)
    with Instance(path) as fmu:
        fmu.start(goal=1.0, f_theta=0.1)
        rows = [fmu.get("s", "v", "f_hat", *inside)]
        for _ in times[1:]:
            fmu.step(0.005)
            rows.append(fmu.get("s", "v", "f_hat", *inside))
    scale = np.abs(expected.outputs).max(axis=1)
    np.testing.assert_allclose(np.array(rows) / scale, expected.outputs.T / scale, rtol=0, atol=AGREE)


def test_records_that_there_cannot_be(tmp_path):
    with pytest.raises(ValueError, match=r"no signal of a block matches 'plant\.z'.*plant\.thrust"):
        pf.diagram.flatten(closed_loop(), record=["plant.*", "plant.z"])
    with pytest.raises(TypeError, match="the text 'plant'"):
        pf.diagram.flatten(closed_loop(), record="plant")
    with pytest.raises(ValueError, match="record belongs to diagrams"):
        export_fmu(GENERAL, tmp_path / "a.fmu", ports=FmuPorts(record=["f_hat"]))
