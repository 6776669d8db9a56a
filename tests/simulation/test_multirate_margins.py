"""Loops of several rates: closed forms, and closed loops assembled by hand over the common period."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import Loop, PhyFilter, linearize_sampled, margins, sampled_open_loop
from phyfilter_ctl.blocks import sampled_block, wired
from tests.peers.lifted_loops import compare

H, A, B = 0.1, 3.0, 4.0
# Crossings are refined to rounding, delays halved to 1e-6.
CLOSE, HALVED = 1e-9, 2e-6


def two_rates(first: float = H, second: float = 2.0 * H, slow: float = B) -> ct.InterconnectedSystem:
    """y' = r - A y_fast - B y_slow, the one held for H, the other for 2 H."""
    parts = [
        ct.ss(
            [[0.0]],
            [[1.0, 1.0, 1.0]],
            [[1.0]],
            [[0.0, 0.0, 0.0]],
            inputs=["a", "b", "r"],
            outputs="y",
            name="body",
        ),
        sampled_block(ct.ss([], [], [], [[-A]], first, inputs="y", outputs="u", name="fast")),
        sampled_block(ct.ss([], [], [], [[-slow]], second, inputs="y", outputs="u", name="slow")),
    ]
    wires = {"body.a": "fast.u", "body.b": "slow.u", "fast.y": "body.y", "slow.y": "body.y"}
    return wired(parts, wires, inputs={"r": "body.r"}, outputs={"y": "body.y"}, name="rates")


def pole(a: float, b: float) -> float:
    """y(2 H)/y(0)."""
    return (1.0 - H * (a + b)) * (1.0 - H * a) - H * b


def test_margins_of_two_rates() -> None:
    slow, fast = margins(two_rates(), at="slow.u"), margins(two_rates(), at="fast.u")
    model = linearize_sampled(two_rates())
    assert np.abs(model.poles()).max() == pytest.approx(abs(pole(A, B)), rel=CLOSE)
    # y at H from r held over the first half: H, and nothing yet of the second.
    assert (model.input_labels, model.dt) == (["r@0", "r@1"], pytest.approx(2.0 * H))
    np.testing.assert_allclose(model.D, [[0.0, 0.0], [H, 0.0]], atol=CLOSE)
    # pole(A, k B) = -1, linear in k; and L = 1/(z - pole(A, 0)) times what B adds, so |1 + L| is least at z = -1.
    lost = (1.0 + pole(A, 0.0)) / (pole(A, 0.0) - pole(A, B))
    assert slow.gain_margin == (0.0, pytest.approx(lost, rel=CLOSE))
    assert slow.gain_frequency[1] == pytest.approx(np.pi / (2.0 * H))
    assert slow.modulus_margin == pytest.approx(1.0 - 1.0 / lost, rel=CLOSE)
    assert sampled_open_loop(two_rates(), "slow.u").ninputs == 1
    # The fast one: pole(k A, B) = -1 and 1 are quadratics in k.
    edges = np.concatenate([np.roots([H * H * A * A, -2.0 * H * A + H * H * A * B, 1.0 - 2.0 * H * B - end])
                            for end in (1.0, -1.0)])  # fmt: skip
    above = min(k.real for k in edges if abs(k.imag) < 1e-12 and k.real > 1.0)
    below = max([0.0, *(k.real for k in edges if abs(k.imag) < 1e-12 and 0.0 < k.real < 1.0)])
    assert fast.gain_margin == pytest.approx((below, above), rel=1e-8)
    assert sampled_open_loop(two_rates(), "fast.u").input_labels == ["in@0", "in@1"]


def test_delay_within_a_step_of_two_rates() -> None:
    """The slow command late by d <= 2 H: the one before acts for d, by hand."""

    def radius(d: float) -> float:
        old = min(d, H), max(d - H, 0.0)  # in either half, of y and the command of before
        first = np.array([1.0 - H * A - (H - old[0]) * b, old[0]])
        after = (1.0 - H * A) * first + np.array([-(H - old[1]) * b, old[1]])
        return float(np.abs(np.linalg.eigvals(np.array([after, [-b, 0.0]]))).max())

    b = 8.0
    margin = margins(two_rates(slow=b), at="slow.u").delay_margin
    assert H < margin < 2.0 * H
    assert radius(margin * (1.0 - HALVED)) < 1.0 < radius(margin * (1.0 + 2.0 * HALVED))


def test_a_fast_filter_in_a_slow_loop_tends_to_one_rate() -> None:
    """Both at one rate: the same margins whether the common period is looked at as one or as lifted over two."""
    once = margins(two_rates(H, H), at="slow.u")
    assert once.gain_margin == (0.0, pytest.approx((2.0 / H - A) / B, rel=CLOSE))
    several = margins(two_rates(H, H), at=["slow.u", "fast.u"])
    # Both at once: the sum of both is what may grow to 2/H.
    assert several.gain_margin[1] == pytest.approx(2.0 / H / (A + B), rel=1e-8)
    assert several.delay_margin == pytest.approx(
        margins(one_gain(A + B), at="gain.u").delay_margin, rel=HALVED
    )
    assert several.modulus_margin <= once.modulus_margin
    assert several.disk.alpha <= once.disk.alpha
    assert several.to_dict()["signal"] == ["slow.u", "fast.u"]


def one_gain(k: float) -> ct.InterconnectedSystem:
    gain = sampled_block(ct.ss([], [], [], [[-k]], H, inputs="y", outputs="u", name="gain"))
    body = ct.tf([1.0], [1.0, 0.0], inputs="u", outputs="y", name="body")
    return wired([gain, body], {"body.u": "gain.u", "gain.y": "body.y"}, outputs={"y": "body.y"}, inputs={})


def test_it_says_where_it_was_linearised() -> None:
    body = ct.nlsys(
        lambda t, x, u, p: [u[0] - x[0] ** 3], None, inputs="u", outputs="y", states="y", name="body"
    )
    gain = sampled_block(ct.ss([], [], [], [[1.0, -1.0]], H, inputs=["r", "y"], outputs="u", name="gain"))
    loop = wired(
        [body, gain],
        {"body.u": "gain.u", "gain.y": "body.y"},
        inputs={"r": "gain.r"},
        outputs={"y": "body.y"},
    )
    moving = margins(loop, at="gain.u", u0=[2.0])
    assert "let it settle longer" in moving.describe()
    rest = linearize_sampled(loop, u0=[2.0], settle=20.0).point
    assert rest.at_rest
    assert rest.states["body.y"] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
def test_random_loops_by_hand() -> None:
    """``python -m tests.peers.lifted_loops --count 1000`` is the long one."""
    tally = compare(24, seed=1)
    assert tally.checked["several rates", "stable"] >= 10
    assert tally.checked["one rate", "delay margin"] >= 4
    assert not tally.failures


@pytest.mark.slow
def test_long_delays() -> None:
    """Past the steps that are tried one by one: the margin of the filter's own loop."""
    filter, h = PhyFilter([1.0]), 0.01
    own = margins(filter.sampled(h), Loop(0.0, 0.2))
    law = ct.ss([], [], [], [[-0.2, -1.0]], h, inputs=["v", "f_hat"], outputs="u", name="law")
    parts = [
        ct.tf([1.0], [1.0, 0.0], inputs="u", outputs="v", name="body"),
        sampled_block(filter.sampled(h), 1, name="filter"),
        sampled_block(law),
    ]
    wires = {
        "body.u": "law.u",
        "filter.x": "body.v",
        "filter.g": "law.u",
        "law.v": "body.v",
        "law.f_hat": "filter.f_hat",
    }
    loop = wired(parts, wires, inputs={"f_theta": "filter.f_theta"}, outputs={"v": "body.v"})
    found = margins(loop, at="body.u")
    assert own.delay_margin > 24 * h
    assert found.delay_margin == pytest.approx(own.delay_margin, rel=3e-6)
