"""Whether the loop is stable, as the browser sees it in a drag, against the library's certified count."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import Loop, PhyFilter, margins, place_poles
from phyfilter_ctl.app.modules import WEB

NODE = shutil.which("node") or shutil.which("node", path=str(Path(sys.executable).parent))
pytestmark = pytest.mark.skipif(NODE is None, reason="node is not installed")

ASK = (
    "import { pathToFileURL } from 'node:url'; import { readFileSync } from 'node:fs';"
    " const load = (name) => import(pathToFileURL(process.argv[1] + '/mathematics/' + name + '.js').href);"
    " const [{ filterOf }, { loopIsStable }] = await Promise.all(['filter', 'stability'].map(load));"
    " const answer = ({ design, assume, dt }) => loopIsStable(filterOf(design), assume, dt);"
    " console.log(JSON.stringify(JSON.parse(readFileSync(0, 'utf8')).map(answer)));"
)
STEP = 0.002  # s
# Ratios this near to the boundary of stability are no test of a count.
NEAR = 0.02


def drawn(rng: np.random.Generator) -> tuple[list[complex], int, dict[str, float]]:
    poles: list[complex] = []
    for _ in range(int(rng.integers(1, 4))):
        size = 10.0 ** rng.uniform(0.0, 2.5)
        if rng.random() < 0.5:
            poles.append(complex(-size))
        else:
            damping = rng.uniform(0.1, 0.95)
            pole = size * complex(-damping, np.sqrt(1.0 - damping**2))
            poles += [pole, pole.conjugate()]
    ratio, delay = 10.0 ** rng.uniform(-1.0, 1.0), float(rng.choice([0.0, 0.02, 0.3]))
    assume = {"ratio": ratio, "lag": float(rng.choice([0.0, 0.02, 0.2])), "delay": delay}
    return poles, int(rng.integers(1, len(poles) + 1)), assume


def test_the_preview_counts_as_the_library_does():
    rng = np.random.default_rng(7)
    questions, expected = [], []
    while len(questions) < 60:
        poles, kind, assume = drawn(rng)
        filter: PhyFilter = place_poles(poles, type=kind)
        lag = ct.tf([1.0], [assume["lag"], 1.0]) if assume["lag"] else None
        margin = margins(filter, Loop(actuator=lag, delay=assume["delay"] + STEP))
        ends = [end for interval in margin.stable_ratios for end in interval if 0.0 < end < np.inf]
        if any(abs(np.log(end / assume["ratio"])) < NEAR for end in ends):
            continue
        numerator = {"kind": "type", "type": kind}
        design = {"poles": [[p.real, p.imag] for p in poles], "numerator": numerator}
        questions.append({"design": design, "assume": assume, "dt": STEP})
        expected.append(margin.stable(assume["ratio"]))
    assert 10 < sum(expected) < 50
    assert NODE is not None
    done = subprocess.run(
        [NODE, "--input-type=module", "-e", ASK, str(WEB)],
        input=json.dumps(questions),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == expected
