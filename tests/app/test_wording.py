"""What the page says of a refusal: no names of messages, fields or arguments."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from designer_messages import message_of

from phyfilter_ctl.app.handling import Session, handle
from phyfilter_ctl.app.modules import WEB

NODE = shutil.which("node") or shutil.which("node", path=str(Path(sys.executable).parent))
pytestmark = pytest.mark.skipif(NODE is None, reason="node is not installed")

ASK = (
    "import { pathToFileURL } from 'node:url'; import { readFileSync } from 'node:fs';"
    " const { inWords } = await import(pathToFileURL(process.argv[1] + '/wording.js').href);"
    " console.log(JSON.stringify(JSON.parse(readFileSync(0, 'utf8')).map(inWords)));"
)
# A path of fields, an argument with its value, an operation, a name with an underscore, a call.
OF_A_PROGRAM = re.compile(r"\w\.\w+[.\[:]|\w='|\bop \w|[a-z]_[a-z]|\w\(\)|^(text|design|low, high)\b")


def test_refusals_are_told_in_words():
    euler = message_of([-20.0], dt=0.5, method="euler")
    asked = [
        {"op": "design", "design": message_of([1.0])},
        {"op": "design", "design": message_of([-1.0] * 9)},
        {"op": "design", "design": message_of([-1.0 + 3.0j])},
        {"op": "design", "design": message_of([-20.0], numerator={"kind": "type", "type": 4})},
        {"op": "family", "family": "butterworth", "order": 2, "cutoff": -1.0},
        {"op": "family", "family": "bandpass", "order": 2, "cutoff": 20.0, "band": [30.0, 10.0]},
        {"op": "export", "design": euler, "kind": "c", "channels": 1},
        {"op": "import", "x": []},
        {"op": "upload", "name": "a.csv", "size": 3, "at": 0, "data": "?"},
        {"op": "open", "name": "a.toml", "text": "[["},
        {"op": "job", "job": 4},
        {"op": "estimate", "design": message_of([-20.0])},
    ]
    refusals = [handle(Session(), {"id": 1, **message}) for message in asked]
    assert [reply["ok"] for reply in refusals] == [False] * len(asked)
    assert sum(bool(OF_A_PROGRAM.search(str(reply["error"]))) for reply in refusals) >= 8
    assert NODE is not None
    done = subprocess.run(
        [NODE, "--input-type=module", "-e", ASK, str(WEB)],
        input=json.dumps(refusals),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert [text for text in told if OF_A_PROGRAM.search(text)] == []
    assert all(text[0].isupper() and text.endswith(".") for text in told), told
    assert told[0] == "Poles: expected a real part below 0, got 1+0j; move it into the left half plane."
    assert told[6].endswith("expected h < 0.1 s: choose the exact method.")
