"""The parts of the residual as an FMU: what separate() finds with causal=True and changes() in it, to 1e-9."""

import control as ct
import numpy as np
import pytest
from exported_fmus import FOLDER, Instance, quick_compiler

import phyfilter_ctl as pf
from phyfilter_ctl.blocks import separation_block
from phyfilter_ctl.estimation import ColouredForce, Payload, separate

H, N = 0.02, 80
AGREE = 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_fmu_is_the_filter_over_a_recording(fmi):
    rng = np.random.default_rng(4)
    g = 3.0 * rng.standard_normal((N, 3)) + [0.0, 0.0, 5.0]
    x = np.cumsum(0.3 * g * H, axis=0) + 0.01 * rng.standard_normal((N, 3))
    parts = [Payload(1.0), ColouredForce(0.5, 5.0)]
    found = separate(pf.Recording.from_arrays(x=x, g=g, dt=H, inertia=2.0), parts, noise=0.02, causal=True)
    # 0.12 s: a change is followed for six samples, and six at a time.
    tests = found.changes("payload", within=0.12).statistic[: N - 6]
    block = separation_block(
        parts, 3, dt=H, noise=0.02, inertia=2.0, watch="payload", within=0.12, restart=False
    )
    labels = block.output_labels
    diagram = ct.interconnect(
        [block], inplist=[f"separation.{label}" for label in block.input_labels], inputs=block.input_labels,
        outlist=[f"separation.{label}" for label in labels], outputs=labels,
    )  # fmt: skip
    path = pf.export_fmu(
        diagram, FOLDER / f"separation{fmi[0]}.fmu", fmi=fmi, name="separation", compiler=quick_compiler()
    )
    rows = []
    with Instance(path) as fmu:
        fmu.start(x=x[0], g=g[0], f_theta=np.zeros(3))
        rows.append(fmu.get("f_hat", "payload", "sd_payload", "known_payload", "statistic"))
        for k in range(1, N):
            # In FMI 2.0 and without event mode the instant at the end of a step takes what was set before it.
            fmu.step(H, x=x[k], g=g[k])
            rows.append(fmu.get("f_hat", "payload", "sd_payload", "known_payload", "statistic"))
    rows = np.array(rows)
    course = found.parts["payload"].course[:, 0]
    known = np.isfinite(course)
    assert 10 < known.sum() < N
    np.testing.assert_array_equal(rows[:, 5] > 0.5, known)
    np.testing.assert_allclose(rows[known, 3], course[known], rtol=0.0, atol=AGREE)
    np.testing.assert_allclose(
        rows[known, 4], found.parts["payload"].sd_course[known, 0], rtol=0.0, atol=AGREE
    )
    np.testing.assert_allclose(rows[:, :3], found.f_hat, rtol=0.0, atol=AGREE * np.abs(found.f_hat).max())
    np.testing.assert_allclose(rows[: N - 6, 6], tests, rtol=0.0, atol=AGREE * tests.max())
