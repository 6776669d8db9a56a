"""A live filter at 500 Hz in real time, with faults injected and processes killed: is its health record true?

    python -m tests.live_soak [--quick] [--minutes 10] [--seed 0]

Samples come in blocks: faults of every kind (:func:`episodes`), then quiet, in which the state is saved and, after
every third block, the process is killed with signal 9. The next one restores the state and goes on at the next block.
Refused are an estimate that is not finite, and a health record that is not the faults injected.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.filter import LiveFilter, LiveRules

DT = 0.002
LONGEST = 10.5 * DT
STUCK_AFTER = 5
POLICY = LiveRules(longest_gap=LONGEST, decay_time=0.2, stuck_after=STUCK_AFTER, clock_jump=60.0)
KINDS = ("nonfinite", "missing", "lost", "stamp", "stuck", "late", "duplicate", "clock")
JUMP = 1000.0  # s
APART = 6  # good samples between two episodes, at least
NAN = float("nan")


def episodes(length: int, seed: tuple[int, ...]) -> list[tuple[str, int]]:
    """Kinds and lengths in samples of about ``length`` samples, good ones between any two."""
    rng, found, used = np.random.default_rng(seed), [("good", APART)], APART
    while used < length - 40 - 2 * APART:
        kind = str(rng.choice(KINDS))
        count = 1 if kind in ("late", "clock") else int(rng.integers(1, 30))
        found += [(kind, count), ("good", int(rng.integers(APART, 40)))]
        used += count + found[-1][1]
    return found


def expected(faults: list[tuple[str, int]]) -> Counter[str]:
    """What a health record counts of these faults."""
    counts: Counter[str] = Counter()
    for kind, n in faults:
        unseen = kind in ("nonfinite", "missing", "lost", "stamp") or (
            kind == "stuck" and n >= STUCK_AFTER - 1
        )
        if kind == "clock":  # there and back again, at two good samples
            counts.update(accepted=2, clock_ahead=1, clock_back=1)
        elif kind == "late":  # it was lost until it came
            counts.update(late=1, lost=1)
        elif kind == "duplicate":
            counts.update(duplicate=n, accepted=1)
        elif kind == "good" or not unseen:
            counts.update(accepted=n)
        else:
            counts[kind] += n
            counts["lost"] += n if kind == "stamp" else 0
            counts["gap"] += (n + 1) * DT > LONGEST
    return counts


class Sensor:
    """Momentum of a body of 1.2 kg under a force of 2 to 4 N, measured with noise, of which samples go astray."""

    def __init__(self, first: int, seed: int) -> None:
        self.k, self.offset, self.rng = first, 0.0, np.random.default_rng((seed, first))
        self.value = self._measured()

    def _measured(self) -> np.ndarray:
        t = self.k * DT
        return np.array([3.0 * t + math.sin(t), 2.0 * t, -t]) / 1.2 + 1e-4 * self.rng.standard_normal(3)

    def _stamp(self, k: int) -> float:
        return k * DT + self.offset + 0.2 * DT * math.sin(12.9898 * k)

    def calls(self, kind: str, n: int):
        """(sample number, stamp, x) of every call that an episode makes."""
        if kind == "clock":
            for offset in (JUMP, 0.0):
                self.k, self.offset = self.k + 1, offset
                yield self.k, self._stamp(self.k), self._measured()
            return
        if kind == "late":  # the one after it, which its neighbour counts, comes first
            self.k += 1
            yield self.k, None, self._measured()
            return
        for i in range(n):
            if kind != "duplicate" or i == 0:
                self.k += 1
            if kind not in ("stuck", "duplicate"):
                self.value = self._measured()
            x = {"nonfinite": np.array([1.0, NAN, np.inf]), "missing": None}.get(kind, self.value)
            if kind == "duplicate" and i == 0:
                self.value = x = self._measured()
                yield self.k, self._stamp(self.k), x
            if kind != "lost":
                yield self.k, NAN if kind == "stamp" else self._stamp(self.k), x

    def deliveries(self, faults: list[tuple[str, int]]):
        """All calls, late ones behind the good sample that follows them."""
        waiting = None
        for kind, n in faults:
            for k, stamp, x in self.calls(kind, n):
                if stamp is None:
                    waiting = (k, self._stamp(k), x)
                    continue
                yield k, stamp, x
                if waiting is not None:
                    late, waiting = waiting, None
                    yield late


def live_filter() -> LiveFilter:
    """Two poles, three channels."""
    return PhyFilter.from_poles([-15.0, -25.0]).sampled(DT).live(3, POLICY)


# -- one process ------------------------------------------------------------------------------------------------------


def run_blocks(options: argparse.Namespace) -> None:
    """Run blocks in real time until killed or done, and tell of each."""
    live, state = live_filter(), Path(options.folder) / "state.json"
    if state.exists():
        live.restore(state)
    ahead = 0
    if state.exists():
        ahead = min(math.ceil((time.time() - options.origin) / (options.block * DT)), options.blocks - 1)
        say(resumed=ahead, saved=round(live.health.time / DT))
    for block in range(ahead, options.blocks):
        busy = int(0.7 * options.block)
        faults = episodes(busy, (options.seed, block))
        sensor, spent, worst_late = Sensor(block * options.block, options.seed), [], 0.0
        faults.append(("good", options.block - sum(n if kind != "clock" else 2 for kind, n in faults)))
        faults[-1] = ("good", faults[-1][1] + sum(n - 1 for kind, n in faults if kind == "duplicate"))
        for k, stamp, x in sensor.deliveries(faults):
            due = options.origin + k * DT
            if (wait := due - time.time()) > 0.0:
                time.sleep(wait)
            began = time.perf_counter()
            f_hat = live.step(stamp, x, None, None, inertia=1.2)
            spent.append(time.perf_counter() - began)
            worst_late = max(worst_late, time.time() - due)
            if not np.isfinite(f_hat).all():
                raise SystemExit(f"sample {k}: f_hat = {f_hat}")
            if k % (options.block // 20) == 0 and k % options.block > busy + options.block // 10:
                live.save(state)
                say(saved_at=k)
        spent_us = 1e6 * np.array(spent)
        say(
            block=block,
            median_us=float(np.median(spent_us)),
            p99_us=float(np.quantile(spent_us, 0.99)),
            calls=len(spent),
            late_ms=1e3 * worst_late,
            error=float(np.abs(f_hat - [3.0 + math.cos(k * DT), 2.0, -1.0]).max()),
        )
    live.save(state)
    print(live.health.describe(), file=sys.stderr, flush=True)


def say(**values: float) -> None:
    print(json.dumps(values), flush=True)


# -- the one that kills -----------------------------------------------------------------------------------------------


def soak(minutes: float, block: int, seed: int) -> int:
    """Start, kill, restart; then compare the last health record with the faults."""
    blocks = max(4, round(minutes * 60.0 / (block * DT)))
    seen, times, lost, kills, longest, errors = [], [], 0, 0, 0.0, []
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "tests.live_soak", "--folder", folder, "--blocks", str(blocks)]
        command += ["--block", str(block), "--seed", str(seed), "--origin", str(time.time() + 3.0)]
        done = False
        while not done:
            child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            assert child.stdout is not None
            saved = 0
            current = 0 if not times else None
            for line in child.stdout:
                said = json.loads(line)
                if "resumed" in said:
                    missed = said["resumed"] * block - said["saved"]
                    seen[-1] = (seen[-1][0], said["saved"] - seen[-1][0] * block)
                    lost, longest = lost + missed, max(longest, (missed + 1) * DT)
                    current = said["resumed"]
                if "saved_at" in said:
                    saved += 1
                    if saved == 2 and current % 3 == 0 and current < blocks - 3:
                        os.kill(child.pid, signal.SIGKILL)
                        kills += 1
                        seen.append((current, 0))  # up to the sample that the next process says was saved
                        break
                if "block" in said:
                    times.append((said["median_us"], said["p99_us"], said["late_ms"]))
                    errors.append(said["error"])
                    seen.append((said["block"], block))
                    current, saved = said["block"] + 1, 0
            done = child.wait() == 0
            child.stdout.close()
            if not done and child.returncode != -signal.SIGKILL:
                return child.returncode
        live = live_filter()
        live.restore(Path(folder) / "state.json")
    return verdict(live, seen, block, seed, lost, kills, longest, times, errors)


def verdict(live, seen, block, seed, lost, kills, longest, times, errors) -> int:
    """Print what was met, beside what was injected."""
    wanted: Counter[str] = Counter(lost=lost, gap=kills)
    for index, samples in seen:
        faults = episodes(int(0.7 * block), (seed, index))
        used = sum({"clock": 2, "duplicate": 1}.get(kind, n) for kind, n in faults)
        wanted += expected([*faults, ("good", samples - used)])
    met = Counter(live.health.counts) + Counter(accepted=live.health.accepted)
    print(f"{'':>12} {'injected':>10} {'recorded':>10}")
    for kind in ("accepted", *live.health.counts):
        print(
            f"{kind:>12} {wanted[kind]:10d} {met[kind]:10d}{'' if wanted[kind] == met[kind] else '  WRONG'}"
        )
    print(f"{kills} processes killed; longest gap {longest:.2f} s, recorded {live.health.worst_gap:.2f} s")
    median, p99, late = np.array(times).T
    print(
        f"step: median {np.median(median):.1f} us, 99 % {np.median(p99):.0f} us (medians of {len(times)} blocks); "
        f"the loop came up to {late.max():.0f} ms late; error of f_hat at the blocks' ends up to {max(errors):.2f} N"
    )
    true = all(wanted[kind] == met[kind] for kind in ("accepted", *live.health.counts))
    print("the health record is true" if true else "THE HEALTH RECORD IS WRONG")
    return 0 if true else 1


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="blocks of 2 s, 16 s in all")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    for name, kind in (("--folder", str), ("--origin", float), ("--blocks", int), ("--block", int)):
        parser.add_argument(name, type=kind, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.folder:
        run_blocks(options)
        return 0
    return soak(
        16.0 / 60.0 if options.quick else options.minutes, 1000 if options.quick else 5000, options.seed
    )


if __name__ == "__main__":
    sys.exit(main())
