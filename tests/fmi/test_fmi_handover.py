"""A diagram and a filter handed over: each export repeats the record, and a wrong record is told apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, simulate
from phyfilter_ctl.blocks import sampled_block, wired
from phyfilter_ctl.codegen import CompilerError, find_compiler
from phyfilter_ctl.fmi import FmuSolver, Reference, hand_over
from phyfilter_ctl.plants import mass
from tests.cpu_budget import release_but

try:
    find_compiler()
except CompilerError:
    pytest.skip("needs a C compiler", allow_module_level=True)

DT, STEPS = 0.01, 60
# Runge-Kutta in the same steps, sums in another order.
SAME = 1e-12
EVERY = ("C", "FMI 2.0", "FMI 3.0")


@pytest.fixture(scope="module")
def cart() -> ct.InterconnectedSystem:
    """A mass behind a sampled PD law: the force is held, so the motion between instants needs no input."""
    gains = [[4.0, -4.0, -3.0]]
    law = ct.ss([], [], [], gains, dt=DT, inputs=["goal", "r", "v"], outputs="force", name="law")
    return wired(
        [mass(1, name="body"), sampled_block(law, name="law")],
        {"body.force": "law.force", "law.r": "body.r", "law.v": "body.v"},
        inputs={"goal": "law.goal"},
        outputs={"place": "body.r", "force": "law.force"},
        name="cart",
    )


@pytest.fixture(scope="module")
def record(cart: ct.InterconnectedSystem) -> Reference:
    times = DT * np.arange(STEPS)
    goal = 1.0 + np.sin(5.0 * times)
    run = simulate(cart, times, goal, method="rk4", max_step=DT, interpolation="hold", backend="vm")
    return Reference(
        times, {"goal": goal}, dict(zip(run.output_labels, np.asarray(run.outputs), strict=True))
    )


@pytest.mark.slow
def test_diagram_is_repeated_by_every_export(
    cart: ct.InterconnectedSystem, record: Reference, tmp_path: Path
) -> None:
    said: list[str] = []
    found = hand_over(
        cart, tmp_path / "cart", record, name="cart", solver=FmuSolver(step=DT), report=said.append
    )
    assert tuple(found.exports) == tuple(said) == EVERY
    assert set(found.differences["C"]) == {"place", "force"}
    assert found.worst is not None
    assert found.worst < SAME, found.differences
    assert np.ptp(record.outputs["place"]) > 0.1
    assert (tmp_path / "cart" / "cart_out.csv").is_file()


@pytest.mark.parametrize("rule", release_but({"hold"}, ["average", "hold"]))
def test_filter_is_repeated_by_every_export_and_importer(rule: str, tmp_path: Path) -> None:
    sampled = PhyFilter.from_poles([-20.0, -30.0]).sampled(DT, g=rule, channels=2)
    rng = np.random.default_rng(0)
    x, g, f_theta = np.cumsum(rng.normal(0.0, 0.01, (STEPS, 2)), axis=0), *rng.normal(0.0, 1.0, (2, STEPS, 2))
    f_hat = sampled.run(x, g, f_theta)
    names = ("x", "g", "f_theta")
    inputs = {f"{n}[{i}]": v[:, i] for n, v in zip(names, (x, g, f_theta), strict=True) for i in range(2)}
    record = Reference(DT * np.arange(STEPS), inputs, {f"f_hat[{i}]": f_hat[:, i] for i in range(2)})
    for importer in ("own", "fmpy"):
        found = hand_over(sampled, tmp_path / importer, record, name="wing", importer=importer)
        assert set(found.exports) == set(EVERY)
        assert found.worst is not None
        assert found.worst < 1e-9 * np.abs(f_hat).max(), found.differences
    late = {label: np.roll(values, 1) for label, values in record.outputs.items()}
    wrong = hand_over(sampled, tmp_path / "late", replace(record, outputs=late), name="wing", formats=["C"])
    expected = max(np.abs(late[label] - values).max() for label, values in record.outputs.items())
    assert wrong.worst == pytest.approx(expected, rel=1e-9)


def test_without_a_compiler_nothing_is_written(
    cart: ct.InterconnectedSystem, record: Reference, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none() -> None:
        raise CompilerError("no C compiler: tried cc")

    monkeypatch.setattr("phyfilter_ctl.fmi.handover.find_compiler", none)
    found = hand_over(cart, tmp_path / "cart", lambda: record, name="cart")
    assert (found.exports, found.differences, found.worst, found.samples) == ({}, {}, None, STEPS)
    assert "no C compiler" in found.message
    assert "pip install 'phyfilter-ctl[cross]'" in found.message
    assert not list(tmp_path.iterdir())


def test_what_is_wrong_is_said_before_anything_is_recorded(
    cart: ct.InterconnectedSystem, record: Reference, tmp_path: Path
) -> None:
    def never() -> Reference:
        raise AssertionError("recorded")

    (tmp_path / "file").touch()
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        hand_over(cart, tmp_path / "a" / "b", never, name="cart")
    with pytest.raises(FileExistsError, match="is a file"):
        hand_over(cart, tmp_path / "file", never, name="cart")
    with pytest.raises(ValueError, match="takes none"):
        hand_over(cart, tmp_path / "cart", never, name="cart", parameters={"body.mass": 2.0})


def test_records_that_do_not_fit_are_refused(
    cart: ct.InterconnectedSystem, record: Reference, tmp_path: Path
) -> None:
    odd = replace(record, times=0.7 * record.times)
    with pytest.raises(ValueError, match="has a step of which the record's is no multiple"):
        hand_over(cart, tmp_path / "cart", odd, name="cart", formats=["C"])
    with pytest.raises(ValueError, match="expected inputs x, g and f_theta of a filter, got goal"):
        hand_over(PhyFilter([5.0]).sampled(DT), tmp_path / "wing", record, name="wing", formats=["C"])
