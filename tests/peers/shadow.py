"""What ``python -m tests.peers.control_examples`` runs: scripts, notebooks and tests in the shadow of simulate.

Every nonlinear or interconnected system that python-control simulates there is simulated again, by python-control at
tight tolerances, by phyfilter_ctl's virtual machine and by its C, and the answers are compared. The backend "draw"
draws its block diagram instead and looks for faults.
"""

from __future__ import annotations

import functools
import json
import os
import re
import runpy
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.codegen import CompilerError
from phyfilter_ctl.simulation.arguments import completed
from tests.drawing.checker import faults

REPORT, BACKENDS = "PHYFILTER_SHADOW_REPORT", "PHYFILTER_SHADOW_BACKENDS"
EACH = "PHYFILTER_SHADOW_EACH"
RTOL, ATOL = 1e-7, 1e-9
# Both integrate to RTOL a step; over a run errors add up, and a switch is met by either at its own step.
EQUAL = 1e-4
_EACH = int(os.environ.get(EACH, "3"))  # calls from one line of a script, such as a sweep
_SLOW = 8.0  # s: what takes python-control longer is not run again at tighter tolerances

# Runs that python-control finishes and simulate does not: the system's name, and what its message must say.
FAILS: tuple[tuple[str, str], ...] = ()
_OURS = Path(pf.__file__).parent

_original: Callable[..., Any] = ct.input_output_response
_seen: Counter[tuple[str, int]] = Counter()
_busy: list[bool] = []


def _place() -> tuple[str, int]:
    """Line of the script, the notebook's cell or the test that asked."""
    frame = sys._getframe(1)
    found = ("", 0)
    while frame is not None:
        name = frame.f_code.co_filename
        if (
            ("/control/" not in name or "/control/tests/" in name)
            and "/scipy/" not in name
            and name != __file__
        ):
            return Path(name).name, frame.f_lineno
        frame = frame.f_back
    return found


def _measured(work: Callable[[], Any]) -> tuple[Any, float]:
    begin = time.perf_counter()
    return work(), time.perf_counter() - begin


def _same(ours: Any, reference: Any) -> float:
    """Largest distance of outputs and states, of the size of each."""
    worst = 0.0
    for mine, theirs in ((ours.y, reference.y), (ours.x, reference.x)):
        if theirs is None or not np.size(theirs):
            continue
        mine, theirs = (np.asarray(a, dtype=float).reshape(len(a), -1) for a in (mine, theirs))
        scale = np.maximum(1.0, np.abs(theirs).max(axis=1, keepdims=True))
        distance = np.abs(mine - theirs) / scale
        worst = max(worst, float(np.max(distance)) if np.isfinite(distance).all() else np.inf)
    return worst


def _spellings(name: str) -> list[str]:
    bare = [name, name.rsplit(".", 1)[-1]]
    return bare + [re.sub(r"\[[^\]]*\]$", "", each) for each in bare]


def _entry(value: Any, name: str) -> float:
    """The number of an array that ``k[0,1]`` stands for."""
    index = re.search(r"\[([\d,]+)\]$", name)
    array = np.asarray(value, dtype=float)
    return float(array[tuple(map(int, index[1].split(",")))] if index and array.ndim else array)


def _is_refusal(error: Exception) -> bool:
    """Whether the error is one that this library raises itself, rather than one that came up inside."""
    frames = traceback.extract_tb(error.__traceback__)
    own = bool(frames) and Path(frames[-1].filename).is_relative_to(_OURS)
    return own and isinstance(error, ValueError | TypeError) and (frames[-1].line or "").startswith("raise ")


def _verdict(
    system: Any, arguments: tuple[Any, ...], params: Any, backend: Any, reference: Any, tight: dict[str, Any]
) -> dict[str, Any]:
    times, inputs, start = arguments
    options: Any = {"backend": backend, "rtol": tight["rtol"], "atol": tight["atol"]}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            whole = completed(system, times, inputs, start, params)
            flat, making = _measured(lambda: pf.flatten(whole, unconnected="zero", params=params))
            # What no block reads, python-control passes over and simulate refuses as a slip.
            # One name goes to all blocks that have it.
            spelt = {
                name: [v.name for v in flat.parameters if name in _spellings(v.name)] for name in params or {}
            }
            options["params"] = {
                full: params[name] if name == full else _entry(params[name], full)
                for name, all_ in spelt.items()
                for full in all_
            }
            ours, first = _measured(lambda: pf.simulate(flat, times, inputs, start, **options)(squeeze=False))
            _, again = _measured(lambda: pf.simulate(flat, times, inputs, start, **options)(squeeze=False))
    except CompilerError as error:
        return {"verdict": "crashed", "why": str(error)}
    except Exception as error:
        kind = "refused" if _is_refusal(error) else "crashed"
        return {
            "verdict": kind,
            "why": str(error) if kind == "refused" else "".join(traceback.format_exception(error)[-3:]),
        }
    distance = _same(ours, reference)
    verdict = "equal" if distance <= EQUAL else "wrong"
    if verdict == "wrong" and not ours.success:
        theirs = reference.success and np.isfinite(np.asarray(reference.y, dtype=float)).all()
        listed = (system.name, True) in ((name, reason in str(ours.message)) for name, reason in FAILS)
        verdict = "failed" if theirs and not listed else "refused"
    return {
        "verdict": verdict,
        "why": ours.message or "",
        "distance": distance,
        "once": making + first,
        "warm": again,
        "callbacks": sorted(ours.callbacks),
        "unread": sorted(
            name
            for name, full in spelt.items()
            if not full and not any(name in _spellings(fixed) for fixed, _ in flat.constants)
        ),
    }


def _drawn(system: Any) -> dict[str, Any]:
    """The system's block diagram, closed and opened one level, held against what a drawing must keep to."""
    if not isinstance(system, ct.InterconnectedSystem):
        return {"verdict": "refused", "why": "one block"}
    try:
        drawings, once = _measured(lambda: [pf.draw(system, depth=depth) for depth in (0, 1)])
        _, warm = _measured(lambda: pf.draw(system))
    except Exception as error:
        return {"verdict": "crashed", "why": "".join(traceback.format_exception(error)[-3:])}
    found = [*faults(drawings[0], system), *faults(drawings[1])]
    why = "; ".join(f"{fault.kind}: {fault.what}" for fault in found)
    return {"verdict": "wrong" if found else "equal", "why": why, "once": once, "warm": warm}


@functools.wraps(_original)
def shadowed(system: Any, *args: Any, **keywords: Any) -> Any:
    """``control.input_output_response`` with a second opinion written to the report."""
    begin = time.perf_counter()
    response = _original(system, *args, **keywords)
    own = time.perf_counter() - begin
    place = _place()
    linear = isinstance(system, ct.StateSpace | ct.TransferFunction) and not isinstance(
        system, ct.InterconnectedSystem
    )
    if _busy or not isinstance(system, ct.NonlinearIOSystem) or linear:
        return response
    _seen[place] += 1
    if _seen[place] > _EACH:
        return response
    _busy.append(True)
    try:
        _report(place, own, system, response, args, keywords)
    finally:
        _busy.pop()
    return response


def _report(
    place: tuple[str, int],
    own: float,
    system: Any,
    response: Any,
    args: tuple[Any, ...],
    keywords: dict[str, Any],
) -> None:
    names = ("timepts", "inputs", "initial_state", "params")
    given = dict(zip(names, args, strict=False)) | {k: v for k, v in keywords.items() if k in names}
    times = np.asarray(keywords.get("T", given.get("timepts")), dtype=float)
    # As python-control has read them: inputs at the times asked for, states in full.
    inputs = keywords.get("U", given.get("inputs", 0.0))
    start = keywords.get("X0", given.get("initial_state", 0.0))
    params = given.get("params")
    entry: dict[str, Any] = {"file": place[0], "line": place[1], "name": system.name}
    method = (keywords.get("solve_ivp_kwargs") or {}).get("method", keywords.get("solve_ivp_method", "RK45"))
    tight = {"rtol": RTOL, "atol": ATOL, "method": "DOP853" if method == "RK45" else method}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            plain, own = _measured(lambda: _original(system, times, inputs, start, params, squeeze=False))
            reference, own_tight = (
                _measured(
                    lambda: _original(
                        system, times, inputs, start, params, squeeze=False, solve_ivp_kwargs=tight
                    )
                )
                if own < _SLOW
                else (plain, own)
            )
        entry["control"] = own_tight
        inputs = np.asarray(reference.u, dtype=float).reshape(-1, len(times))
        start = (
            np.asarray(reference.x, dtype=float).reshape(-1, len(times))[:, 0]
            if np.size(reference.x)
            else np.zeros(0)
        )
    except Exception as error:  # it answered before: what it keeps from call to call, or a solver too tight
        entry["skipped"] = f"{type(error).__name__}: {error}"
    else:
        for backend in os.environ.get(BACKENDS, "vm c").split():
            if backend == "draw":
                entry[backend] = _drawn(system)
                continue
            entry[backend] = _verdict(
                system, (times, inputs if inputs.size else None, start), params, backend, reference, tight
            )
            if entry[backend]["verdict"] == "wrong":
                # Both at a hundredth of the tolerance: what is left is a difference of the systems.
                finer = tight | {"rtol": 0.01 * RTOL, "atol": 0.01 * ATOL}
                limit = _original(system, times, inputs, start, params, squeeze=False, solve_ivp_kwargs=finer)
                entry[backend] = _verdict(
                    system, (times, inputs if inputs.size else None, start), params, backend, limit, finer
                )
    with open(os.environ[REPORT], "a", encoding="utf-8") as file:
        file.write(json.dumps(entry) + "\n")


def install() -> None:
    """Put it wherever python-control's function is already known by name."""
    for module in list(sys.modules.values()):
        if getattr(module, "input_output_response", None) is _original:
            module.input_output_response = shadowed  # pyright: ignore[reportAttributeAccessIssue]


def run_notebook(path: Path) -> None:
    """Cells one after another; one that fails does not stop the rest."""
    scope: dict[str, Any] = {"__name__": "__main__"}
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    for i, cell in enumerate(cells):
        if cell["cell_type"] != "code":
            continue
        text = "".join(cell["source"])
        text = re.sub(r"^(\s*)[%!].*$", r"\1pass", text, flags=re.MULTILINE)
        try:
            exec(compile(text, f"{path.name}[{i}]", "exec"), scope)
        except Exception as error:
            print(f"{path.name}, cell {i}: {type(error).__name__}: {error}")


def pytest_configure(config: pytest.Config) -> None:
    import control.matlab
    import control.optimal  # noqa: F401

    install()


if __name__ == "__main__":
    # As an imported module, so that its counters are one.
    from tests.peers import shadow

    example = Path(sys.argv[1])
    os.chdir(example.parent)
    sys.path.insert(0, str(example.parent))
    sys.argv = [str(example)]
    shadow.install()
    if example.suffix == ".ipynb":
        shadow.run_notebook(example)
    else:
        runpy.run_path(str(example), run_name="__main__")
