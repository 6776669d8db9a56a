"""Fixed random cases and what the library says of each: figures by name."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

import control as ct
import numpy as np

import phyfilter_ctl as pf

Figures = dict[str, Any]
FILTERS, EXPORTED = 300, 12
METHODS = ("exact", "tustin", "euler")
SHAPES = {
    "lowpass": pf.Shape(),
    "type 1": pf.Shape("general"),
    "free gain": pf.Shape("general", dc_gain=None),
    "damped": pf.Shape(damping=0.6, pole_range=(1.0, 80.0)),
}


def flat(value: Any, name: str = "") -> Figures:
    """Numbers and words in a result; of long arrays size, sum, squares and extremes."""
    if isinstance(value, Enum):
        return {name: str(value)}
    if isinstance(value, np.ndarray | np.generic) and np.ndim(value):
        array = np.asarray(value)
        if array.dtype.kind == "c":
            return flat(array.real, f"{name}.real") | flat(array.imag, f"{name}.imag")
        if array.dtype.kind not in "fiub":
            return {name: str(array.tolist())}
        if array.size <= 8:
            return {f"{name}[{k}]": _number(entry) for k, entry in enumerate(array.ravel().tolist())}
        real = array[np.isfinite(array)].astype(float)
        told = (array.size, real.sum(), (real**2).sum(), real.min(initial=np.inf), real.max(initial=-np.inf))
        return {
            f"{name}.{word}": _number(entry)
            for word, entry in zip(("size", "sum", "squares", "min", "max"), told, strict=True)
        }
    if is_dataclass(value) and not isinstance(value, type):
        parts = {entry.name: getattr(value, entry.name) for entry in fields(value)}
        return flat(parts, name)
    if isinstance(value, Mapping):
        return {
            k: v for key, part in value.items() for k, v in flat(part, f"{name}.{key}".lstrip(".")).items()
        }
    if isinstance(value, list | tuple):
        return {k: v for n, part in enumerate(value) for k, v in flat(part, f"{name}[{n}]").items()}
    if isinstance(value, complex):
        return {f"{name}.real": _number(value.real), f"{name}.imag": _number(value.imag)}
    if isinstance(value, bool | str) or value is None:
        return {name: value}
    if isinstance(value, int | float | np.generic):
        return {name: _number(value)}
    return {name: type(value).__name__}


def _number(value: Any) -> float | int | str:
    number = value.item() if isinstance(value, np.generic) else value
    return number if np.isfinite(number) else str(number)  # JSON has no infinities


def asked(calls: Mapping[str, Callable[[], Any]]) -> Figures:
    """What each call answers; a refusal by its type."""
    found: Figures = {}
    for name, call in calls.items():
        try:
            found |= flat(call(), name)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            found[name] = f"refused: {type(error).__name__}"
    return found


def random_filter(seed: int) -> pf.PhyFilter | pf.SampledPhyFilter:
    """Pole placement, prototypes and general forms of order 1 to 4; half of them sampled, some late or limited."""
    rng = np.random.default_rng([seed, 1])
    order, fast = int(rng.integers(1, 5)), float(10 ** rng.uniform(0.3, 1.8))
    match int(rng.integers(4)):
        case 0:
            made = pf.lowpass(order, fast)
        case 1:
            made = pf.PhyFilter.from_poles(-fast * rng.uniform(0.4, 1.6, order))
        case 2:
            made = pf.lowpass(order, fast, family="bessel")
        case _:
            a = np.poly(-fast * rng.uniform(0.5, 1.5, order))[::-1][:-1]
            made = pf.PhyFilter(
                a, a * rng.uniform(0.5, 1.0, order) * (np.arange(order) > 0) + a * (np.arange(order) == 0)
            )
    if rng.random() < 0.5:
        return made
    options: dict[str, Any] = {}
    if rng.random() < 0.3:
        options["delay"] = 0.01
    if rng.random() < 0.2:
        options["limit"] = 5.0
    return made.sampled(float(rng.choice([0.002, 0.005, 0.01])), str(rng.choice(METHODS)), **options)


def of_filter(seed: int) -> Figures:
    """All analyses of a random filter in a random loop under a random disturbance."""
    try:
        system = random_filter(seed)
    except ValueError as error:
        return {"filter": f"refused: {type(error).__name__}"}
    rng = np.random.default_rng([seed, 2])
    actuator = ct.tf([1.0], [float(rng.uniform(0.005, 0.08)), 1.0]) if rng.random() < 0.7 else None
    inner: dict[str, Any] = {"actuator": actuator, "delay": float(rng.choice([0.0, 0.004, 0.02]))}
    outer: dict[str, Any] = inner | {"kp": float(rng.uniform(2.0, 20.0)), "kd": float(rng.uniform(2.0, 9.0))}
    told: dict[str, Any] = {"g": str(rng.choice(["commanded", "applied"]))}
    ratio = float(rng.uniform(0.6, 1.6))
    residual = {1: float(rng.uniform(0.5, 5.0))} | (
        {0: float(rng.uniform(1.0, 9.0))} if rng.random() < 0.5 else {}
    )
    noise, off = float(rng.uniform(0.0, 0.05)), float(rng.choice([0.0, 0.1]))
    moved: dict[str, Any] = {"inertia_error": off, "rate": 2.0} if off else {}
    dt = None if isinstance(system, pf.SampledPhyFilter) else 0.005
    omega = np.geomspace(0.1, 200.0, 40)
    shape = pf.gauss_markov(2.0, 0.4)
    calls: dict[str, Callable[[], Any]] = {
        "filter": lambda: system,
        "response": lambda: pf.frequency_response(system, omega),
        "poles and zeros": lambda: pf.frequency_response(system).pole_zero_map,
        "inner loop": lambda: pf.margins(system, pf.Loop(inertia_ratio=ratio, **inner, **told)),
        "complete loop": lambda: pf.margins(system, pf.Loop(inertia_ratio=ratio, **outer, **told)),
        "complete loop at dt": lambda: pf.margins(system, pf.Loop(**outer), dt=dt) if dt else None,
        "saturation": lambda: pf.saturation_margin(system, pf.Loop(inertia_ratio=ratio, **outer)),
        "moving inertia": lambda: pf.inertia_tolerance(system, pf.Loop(**inner), ratios=[0.7, 1.4], dt=dt),
        "variance": lambda: pf.error_variance(system, pf.Gaussian(shape, noise=noise + 0.01)),
        "tube": lambda: pf.tracking_error(
            system, pf.Loop(**outer), pf.Bounded(residual, noise=noise), inertia=1.0, dt=dt
        ),
        "deviation": lambda: pf.tracking_error(
            system, pf.Loop(**outer), pf.Gaussian(shape, noise=noise + 0.01), inertia=1.0, dt=dt
        ),
        "page": lambda: pf.analyze(
            system, pf.Loop(**outer, **told), pf.Bounded(residual, noise=noise, **moved)
        ).to_dict(),
    }
    for method in ("exact", "ellipsoid", "lyapunov", "lyapunov-raw"):
        calls[f"bound, {method}"] = partial(
            pf.error_bound, system, pf.Bounded(residual, noise=noise, **moved), method=method
        )
    if isinstance(system, pf.SampledPhyFilter):
        t = system.dt * np.arange(400)
        calls["run"] = lambda: system.run(
            np.sin(3.0 * t)[:, None], np.cos(t)[:, None], 0.1 * np.sin(t)[:, None]
        )
    return asked(calls)


def recording(number: int) -> pf.Recording:
    """A flight of one to three channels with noise, some with a model, a gap or labels that are off."""
    rng = np.random.default_rng([number, 3])
    n, h, channels = 1200, 0.01, 1 + number % 3
    t = h * np.arange(n)
    phases = rng.uniform(0.0, 6.0, channels)
    f = np.stack([np.sin(1.3 * t + p) + 0.4 * np.sin(5.0 * t + 2.0 * p) for p in phases], axis=1)
    g = np.stack([np.cos(0.7 * t + p) for p in phases], axis=1)
    x = np.vstack([np.zeros(channels), np.cumsum(h * (f + g), axis=0)[:-1]])
    x += 2e-3 * rng.standard_normal(x.shape)
    given: dict[str, Any] = {"x": x, "g": g, "label": f + (0.05 if number == 4 else 0.0)}
    if number >= 3:
        given["f_theta"] = 0.8 * f + 0.05
    if number == 5:
        kept = np.r_[0:500, 530:n]
        return pf.Recording.from_arrays(**{key: value[kept] for key, value in given.items()}, times=t[kept])
    return pf.Recording.from_arrays(**given, dt=h)


def of_learning(number: int, shape: str, order: int) -> Figures:
    label, quick = "offset" if number == 4 else "given", pf.Search(starts=1, cross_validate=False)

    def learned() -> Any:
        found = pf.learn(recording(number), order, shape=SHAPES[shape], label=label, search=quick)
        return {"filter": found.filter, "cost": found.cost, "status": found.status}

    return asked({"learned": learned})


def of_export(seed: int) -> Figures:
    """Digests of the files; of an FMU its description without the time it was made."""
    system = random_filter(seed)
    sampled = system if isinstance(system, pf.SampledPhyFilter) else system.sampled(0.005)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def code(**options: Any) -> dict[str, str]:
            target = folder / "c"
            pf.export_c(sampled, target, channels=2, **options)
            return {
                path.name: _digest(path.read_bytes()) for path in sorted(target.rglob("*")) if path.is_file()
            }

        from phyfilter_ctl.fmi import FmuPorts

        ports = FmuPorts(channels=2)

        def fmu(version: str) -> str:
            path = pf.export_fmu(sampled, folder / "a.fmu", fmi=version, platforms=(), ports=ports)
            with zipfile.ZipFile(path) as archive:
                text = archive.read("modelDescription.xml").decode()
            return _digest(re.sub(r'generationDateAndTime="[^"]*"', "", text).encode())

        return asked(
            {
                "c": code,
                "c, float": partial(code, real="float"),
                "fmu 2": partial(fmu, "2.0"),
                "fmu 3": partial(fmu, "3.0"),
            }
        )


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def of_model(name: str) -> Figures:
    """What its quick run reports."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "figures.json")
        command = [sys.executable, "-m", "phyfilter_ctl", "run", name, "--quick", "--json", str(path)]
        done = subprocess.run(
            [*command, "--picture", str(path.with_suffix(".png"))], capture_output=True, text=True
        )
        if done.returncode:
            return {"run": f"status {done.returncode}"}
        return {
            key: value
            for key, value in flat(json.loads(path.read_text())).items()
            if not re.search(r"seconds|realtime|_ms", key)  # of this machine
        }


SECTIONS: Mapping[str, Callable[[], Mapping[str, Callable[[], Figures]]]] = {
    "filters": lambda: {f"filter {seed}": partial(of_filter, seed) for seed in range(FILTERS)},
    "learning": lambda: {
        f"recording {number}, {shape}, order {order}": partial(of_learning, number, shape, order)
        for number in range(6)
        for shape in SHAPES
        for order in range(1, 5)
    },
    "exports": lambda: {f"export {seed}": partial(of_export, seed) for seed in range(EXPORTED)},
    "models": lambda: {
        name: partial(of_model, name) for name in ("acceleration", "drone", "aerial_manipulator")
    },
}
