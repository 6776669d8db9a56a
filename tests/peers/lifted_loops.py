"""Random sampled loops, of one rate and of several, against closed loops assembled by hand over the common period.

``python -m tests.peers.lifted_loops --count 1000`` prints, for each kind of loop, how many verdicts and margins were
checked and how many were wrong. By hand means numpy and scipy's exponential: each filter, law and hold is written down
here, and a delayed signal is looked up in a history of all breakpoints. Nothing is shared but the sampled filters'
coefficients. A margin is right if the loop by hand is stable at 0.999 of it and unstable at 1.001.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import dataclass

import control as ct
import numpy as np
from scipy.linalg import expm

from phyfilter_ctl import Loop, PhyFilter, SampledPhyFilter, linearize_sampled, margins
from phyfilter_ctl.blocks import sampled_block, wired

INSIDE, OUTSIDE = 0.999, 1.001
# A pole this close to the unit circle may fall on either side by rounding.
MARGINAL = 1e-9
# Margins of delay below this share of a step, or past so many periods, are not tried by hand.
LEAST_DELAY, MOST_PERIODS = 1e-3, 12.0
DIRECTIONS = np.exp(1j * np.linspace(0.0, np.pi, 7))
SIGNALS = ("body.tau", "law.f_hat", "law.v", "filter.x", "law.ref")


@dataclass(frozen=True)
class Case:
    """Body (actuator lag, drag, force to velocity to position) with filter, law on v and outer law on p.

    u = -kd (v - ref) - f_hat, ref = -kp p; ``law_continuous``: u moves with v between the instants.
    """

    signal: str
    base: float
    every: tuple[int, int, int]  # ticks of filter, law and outer law
    sampled: SampledPhyFilter
    ratio: float
    lag: float
    drag: float
    kp: float
    kd: float
    law_continuous: bool

    @property
    def instants(self) -> int:
        return len(_ticks(self))


def random_case(rng: np.random.Generator, *, multirate: bool) -> Case:
    ticks = (1, 1, 1)
    while multirate and len(set(ticks)) == 1:
        ticks = tuple(int(each) for each in rng.choice([1, 2, 3, 4, 6], 3))
    n = int(rng.integers(1, 4))
    base = float(rng.choice([0.002, 0.01, 1.0 / 300.0, 0.02])) / (2.0 if multirate else 1.0)
    w = 10.0 ** rng.uniform(0.5, 2.0)
    poles = -w * rng.uniform(0.6, 1.6, n) + 0j
    if n > 1 and rng.random() < 0.5:
        poles[:2] = w * np.exp(1j * np.pi * (1.0 + 0.3 * rng.random() * np.array([1.0, -1.0])))
    a = PhyFilter.from_poles(poles).a
    filter = PhyFilter(a, a if n > 1 and rng.random() < 0.3 else None)
    method = str(rng.choice(["exact", "tustin", "matched"]))
    delay = float(rng.choice([0.0, 0.0, 0.4, 1.0, 1.7])) * base * ticks[0]
    law_continuous = bool(rng.random() < 0.15)
    if law_continuous:
        ticks = (ticks[0], ticks[0], ticks[2])
    signal = "body.tau" if law_continuous else str(rng.choice(SIGNALS))
    return Case(
        signal, base, ticks, filter.sampled(base * ticks[0], method=method, delay=delay),
        ratio=10.0 ** rng.uniform(-0.5, 0.5), lag=10.0 ** rng.uniform(-2.3, -1.0), drag=rng.uniform(0.0, 1.0),
        kp=rng.uniform(0.5, 4.0), kd=10.0 ** rng.uniform(0.2, 1.2), law_continuous=law_continuous,
    )  # fmt: skip


def diagram(case: Case) -> ct.InterconnectedSystem:
    periods = [case.base * tick for tick in case.every]
    law = ct.ss([], [], [], [[-case.kd, case.kd, -1.0]], 0 if case.law_continuous else periods[1],
                inputs=["v", "ref", "f_hat"], outputs="u", name="law")  # fmt: skip
    outer = ct.ss([], [], [], [[-case.kp]], periods[2], inputs="p", outputs="ref", name="outer")
    parts = [
        ct.ss(*_body(case)[:2], np.eye(3)[1:], 0, inputs="tau", outputs=["v", "p"], name="body"),
        sampled_block(case.sampled, 1, inertia=case.ratio, name="filter"),
        law if case.law_continuous else sampled_block(law),
        sampled_block(outer),
    ]
    wires = {"body.tau": "law.u", "filter.x": "body.v", "filter.g": "law.u", "law.v": "body.v", "law.ref": "outer.ref",
             "law.f_hat": "filter.f_hat", "outer.p": "body.p"}  # fmt: skip
    return wired(parts, wires, inputs={"f_theta": "filter.f_theta"}, outputs={"v": "body.v"}, name="loop")


# -- by hand -------------------------------------------------------------------------------------------------------


def _body(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """f' = (tau - f)/lag, v' = f - drag v, p' = v."""
    A = np.array([[-1.0 / case.lag, 0.0, 0.0], [1.0, -case.drag, 0.0], [0.0, 1.0, 0.0]])
    return A, np.array([[1.0 / case.lag], [0.0], [0.0]])


def _ticks(case: Case) -> list[int]:
    whole = np.lcm.reduce(case.every)
    return [t for t in range(whole) if any(t % each == 0 for each in case.every)]


def _companion(case: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """w+ = A w + B u, f_hat = c w+ of the sampled filter, from F itself where its coefficients are known by formula."""
    F, h, n = case.sampled.filter, case.sampled.dt, case.sampled.filter.order
    A, B = np.diag(np.ones(n - 1), 1), np.eye(n)[:, -1:]
    A[-1] = -F.a
    if case.sampled.sampling.method == "exact":
        E = expm(h * np.block([[A, B], [np.zeros((1, n + 1))]]))
        return E[:n, :n], E[:n, n:], F.b[None]
    if case.sampled.sampling.method == "tustin":
        half = np.linalg.inv(np.eye(n) - 0.5 * h * A)
        return half @ (np.eye(n) + 0.5 * h * A), h * half @ B, F.b[None]
    dA, equilibrium, C = case.sampled.transition
    return np.eye(n) + dA, -dA @ equilibrium[:, None], C[None]


class Hand:
    """The closed loop over the common period on rows of linear functions of its state."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.Ad, self.Bd, self.C = _companion(case)
        self.n = len(self.Ad)
        late = case.sampled.sampling.delay / case.sampled.dt
        self.whole = int(np.floor(late + 1e-9))
        self.part = max(late - self.whole, 0.0)
        self.H = case.base * float(np.lcm.reduce(case.every))

    def radius(self, factor: complex = 1.0, delay: float = 0.0) -> float:
        """Spectral radius with the signal times a factor, or late; free integrators of a loop without gains aside."""
        poles = np.linalg.eigvals(self._matrix(factor, delay))
        free = 0 if self.case.kd else 2
        return float(np.abs(poles[np.argsort(np.abs(poles - 1.0))][free:]).max())

    def _matrix(self, factor: complex, delay: float) -> np.ndarray:
        case, H = self.case, self.H
        A, B = _body(case)
        times = case.base * np.array(_ticks(case))
        shifts = [times] if not delay else [times, times + delay, times - delay]
        breaks = np.unique(np.round(np.concatenate(shifts) % H / H, 12)) * H
        breaks = breaks[breaks < H * (1.0 - 1e-11)]
        kept = len(breaks) * (int(np.ceil(delay / H)) + 1) if delay else 0
        g_kept = self.whole + 2
        size = 3 + self.n + 1 + g_kept + 3 + kept
        rows = np.eye(size, dtype=complex if np.iscomplex(factor) else float)
        cuts = np.cumsum([3, self.n, 1, g_kept, 3])
        body, w, before, g, held, past = np.split(rows, cuts)
        f_hat, ref, u = held
        # (time, value of the signal just after it), newest last.
        history = [(breaks[i % len(breaks)] + H * (i // len(breaks) - kept // max(len(breaks), 1)), row)
                   for i, row in enumerate(past)]  # fmt: skip

        def seen(name: str, value: np.ndarray, now: float) -> np.ndarray:
            if name != case.signal:
                return value
            if not delay:
                return factor * value
            return factor * next(row for t, row in reversed(history) if t <= now - delay + 1e-9 * H)

        for i, now in enumerate(breaks):
            tick = now / case.base
            due = [abs(tick / each - round(tick / each)) < 1e-6 for each in case.every]
            x = seen("filter.x", body[1], now)
            if due[0]:
                h = case.sampled.dt
                mean = (1.0 - self.part) * g[self.whole] + self.part * g[self.whole + 1]
                w = self.Ad @ w + self.Bd * (case.ratio * (x - before[0]) / h - mean)
                f_hat = (self.C @ w)[0]
                before = x[None]
            if due[2]:
                ref = -case.kp * body[2]
            if due[1] and not case.law_continuous:
                v, r, d = (
                    seen(*each, now) for each in (("law.v", body[1]), ("law.ref", ref), ("law.f_hat", f_hat))
                )
                u = -case.kd * (v - r) - d
            free = case.kd * ref - f_hat
            if case.law_continuous:
                u = free - case.kd * body[1]
            if due[0]:
                g = np.concatenate([u[None], g[:-1]])
            values = {
                "body.tau": u,
                "filter.x": body[1],
                "law.v": body[1],
                "law.ref": ref,
                "law.f_hat": f_hat,
            }
            if kept:
                history = [*history[1:], (now, values[case.signal])]
            length = (breaks[i + 1] if i + 1 < len(breaks) else H) - now
            if case.law_continuous:
                drift = A - factor * case.kd * B @ np.eye(1, 3, 1)
                tau = factor * free
            else:
                drift, tau = A, seen("body.tau", u, now)
            E = expm(length * np.block([[drift, B], [np.zeros((1, 4))]]))
            body = E[:3, :3] @ body + E[:3, 3:] * tau
        rows = [body, w, before, g, np.array([f_hat, ref, u]), *(row[None] for _, row in history)]
        return np.concatenate(rows)


# -- comparison ----------------------------------------------------------------------------------------------------


class Tally:
    """What was checked and what was wrong, by kind of loop and by margin; and how long it took."""

    def __init__(self) -> None:
        self.checked: Counter[tuple[str, str]] = Counter()
        self.wrong: Counter[tuple[str, str]] = Counter()
        self.failures: list[str] = []
        self.seconds: dict[tuple[int, int], list[tuple[float, float]]] = {}

    def __call__(self, kind: str, what: str, right: bool, case: object) -> None:
        self.checked[kind, what] += 1
        if not right:
            self.wrong[kind, what] += 1
            self.failures.append(f"{kind}, {what}: {case}")

    def table(self) -> str:
        rows = [f"{'loops':<14}{'margin':<22}{'checked':>8}{'wrong':>7}"]
        rows += [f"{k:<14}{w:<22}{n:>8}{self.wrong[k, w]:>7}" for (k, w), n in sorted(self.checked.items())]
        rows += ["", f"{'instants':>9}{'states':>8}{'loops':>7}{'linearised/ms':>15}{'all margins/ms':>16}"]
        for (instants, states), spent in sorted(self.seconds.items()):
            first, second = 1e3 * np.median(np.array(spent), axis=0)
            rows.append(f"{instants:>9}{f'<{states}':>8}{len(spent):>7}{first:>15.1f}{second:>16.1f}")
        return "\n".join([*rows, *self.failures])


def check_sampled(tally: Tally, case: Case, kind: str) -> None:
    hand, loop = Hand(case), diagram(case)
    start = time.perf_counter()
    model = linearize_sampled(loop)
    middle = time.perf_counter()
    margin = margins(loop, at=case.signal + "[0]" * (case.signal == "filter.x"))
    text = margin.describe()
    spent = middle - start, time.perf_counter() - middle
    tally.seconds.setdefault((case.instants, 10 * (model.nstates // 10 + 1)), []).append(spent)
    own = hand.radius()
    if abs(own - 1.0) <= MARGINAL:
        return
    tally(kind, "stable", margin.is_stable == (own < 1.0), case)
    tally(kind, "poles", abs(np.abs(model.poles()).max() - own) <= 1e-9, case)
    if not margin.is_stable:
        return
    assert "stable            yes" in text

    def at(what: str, inside: tuple[complex, float], outside: tuple[complex, float]) -> None:
        tally(kind, what, hand.radius(*inside) < 1.0 <= hand.radius(*outside), case)

    low, high = margin.gain_margin
    if low:
        at("gain margin, low", (low / INSIDE, 0.0), (low * INSIDE, 0.0))
    if np.isfinite(high):
        at("gain margin, high", (high * INSIDE, 0.0), (high * OUTSIDE, 0.0))
    if np.isfinite(margin.phase_margin):
        at("phase margin", *((np.exp(1j * share * margin.phase_margin), 0.0) for share in (INSIDE, OUTSIDE)))
    delay, step = margin.delay_margin, hand.H / case.instants
    if LEAST_DELAY * step < delay < MOST_PERIODS * hand.H:
        at("delay margin", (1.0, INSIDE * delay), (1.0, OUTSIDE * delay))
    if margin.open_loop is None:
        return
    for skew, name in ((1.0, "modulus margin"), (0.0, "disk margin")):
        disk = margin.disk_margin(skew=skew)
        up, down = 0.5 * (1.0 - skew), 0.5 * (1.0 + skew)
        sizes = INSIDE * disk.alpha * DIRECTIONS
        tally(
            kind,
            f"{name}, inside",
            all(hand.radius((1 + up * d) / (1 - down * d)) < 1.0 for d in sizes),
            case,
        )
        if margin.open_loop.ninputs == 1:
            # 1 + f L = 0 at the frequency that binds.
            f = -1.0 / complex(margin.open_loop(np.exp(1j * disk.frequency * hand.H)))
            d = (f - 1.0) / (up + down * f)
            at(name, *(((1 + up * s * d) / (1 - down * s * d), 0.0) for s in (INSIDE, OUTSIDE)))


def check_structured(tally: Tally, case: Case, rng: np.random.Generator) -> None:
    """:func:`prior_margin` and :func:`loop_margin` on the loops they know."""
    kp, kd = float(rng.uniform(1.0, 20.0)), float(rng.uniform(1.0, 8.0))
    command = float(rng.choice([0.0, 0.3, 1.0, 2.6])) * case.sampled.dt
    options = {"actuator": ct.tf([1.0], [case.lag, 1.0]), "delay": command, "inertia_ratio": case.ratio}
    found = {
        "margins, complete loop": (margins(case.sampled, Loop(kp, kd, **options)), kp / kd, case.ratio * kd),
        "margins, inner loop": (margins(case.sampled, Loop(**options)), 0.0, 0.0),
    }
    late = command + case.sampled.sampling.delay
    for kind, (margin, outer, inner) in found.items():
        hand = Hand(Case("body.tau", case.sampled.dt, (1, 1, 1), case.sampled, case.ratio, case.lag, 0.0, outer, inner,
                         False))  # fmt: skip
        own = hand.radius(1.0, late)
        if abs(own - 1.0) <= 1e-5:  # the free integrators' eigenvalues are that uncertain
            continue
        tally(kind, "stable", margin.is_stable == (own < 1.0), case)
        low, high = margin.gain_margin
        if np.isfinite(high):
            hand_radii = [hand.radius(share * high, late) for share in (INSIDE, OUTSIDE)]
            tally(kind, "gain margin, high", hand_radii[0] < 1.0 <= hand_radii[1], case)
        if low > 0.0 and kind == "margins, complete loop":
            hand_radii = [hand.radius(low * share, late) for share in (OUTSIDE, INSIDE)]
            tally(kind, "gain margin, low", hand_radii[0] < 1.0 <= hand_radii[1], case)
        if margin.is_stable and LEAST_DELAY * hand.H < margin.delay_margin < MOST_PERIODS * hand.H:
            radii = [hand.radius(1.0, late + share * margin.delay_margin) for share in (INSIDE, OUTSIDE)]
            tally(kind, "delay margin", radii[0] < 1.0 <= radii[1], case)


def compare(count: int, seed: int = 0) -> Tally:
    rng, tally = np.random.default_rng(seed), Tally()
    for i in range(count):
        multirate = bool(i % 2)
        case = random_case(rng, multirate=multirate)
        check_sampled(tally, case, "several rates" if multirate else "one rate")
        if not multirate:
            check_structured(tally, case, rng)
    return tally


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    result = compare(options.count, options.seed)
    print(result.table())
    raise SystemExit(bool(result.failures))
