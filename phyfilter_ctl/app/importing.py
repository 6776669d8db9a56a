"""The designer's operations that bring a recording in, and say what it is like."""

from __future__ import annotations

import base64
import binascii
import math
from importlib import import_module
from typing import Protocol, cast

import numpy as np

from ..estimation import smooth_label
from ..logfiles.clock import TimeUnit
from ..recording import Recording
from . import logs
from .checking import Fields
from .imports import force_unit, import_log, read_roles
from .inbox import LARGEST_PIECE, Inbox
from .preview import preview

__all__ = ["example", "import_", "measured", "preview_", "upload"]

_LARGEST_FILE = 2**50  # bytes; the disk is asked how much it takes
_LONGEST_KEY = 400
_SEED = 1  # of the example
_SHARE = 1.0
_MOST_MEASURED = 100_000  # samples that step, slope and noise are taken over

# Fields of op "import".
ROLES = ("time", "time_unit", "x", "label", "g", "f_theta", "inertia", "unit_x", "unit_f", "step")

Reply = dict[str, object]


class Holder(Protocol):
    """What these operations have of a session."""

    @property
    def inbox(self) -> Inbox:
        """The file that is to be opened."""
        ...

    @property
    def log(self) -> Recording | None:
        """The open log."""
        ...

    def set_log(self, log: Recording | None) -> None:
        """Open another log, or none."""
        ...


def upload(session: Holder, fields: Fields) -> Reply:
    """A piece of a file: fields name, size, at and data (base64)."""
    text = fields.text("data", 4 * (LARGEST_PIECE // 3 + 1))
    try:
        piece = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        raise fields.error("data", "expected base64") from None
    size = fields.integer("size", 1, _LARGEST_FILE)
    name = fields.text("name")
    return {"received": session.inbox.receive(name, size, fields.integer("at", 0, size), piece), "size": size}


def preview_(session: Holder, fields: Fields) -> Reply:
    """What the file that was sent holds: fields time and time_unit, where the user chose them."""
    time = fields.text("time", _LONGEST_KEY) if "time" in fields else None
    unit = fields.choice("time_unit", ("s", "ms", "us", "ns")) if "time_unit" in fields else None
    source = session.inbox.source
    try:
        return preview(source, time, cast(TimeUnit | None, unit))
    except ValueError as error:  # its text names the place of the copy
        raise ValueError(
            str(error).replace(f"{source.path}: ", "").replace(str(source.path), source.name)
        ) from error


def import_(session: Holder, fields: Fields) -> Reply:
    """Open the file that was sent, with the roles of its columns."""
    roles = read_roles(fields)
    log, messages = import_log(session.inbox.source, roles)
    unit = force_unit(session.inbox.source, roles)
    session.set_log(log)
    session.inbox.close()
    return {"log": {**logs.summary(log), "unit_f": unit}, "messages": messages}


def example(session: Holder, fields: Fields) -> Reply:
    """Open a flight that the acceleration model generates; nothing of it is recorded."""
    generate = import_module("phyfilter_ctl.models.acceleration.flights").generate
    flight: Recording = generate("test", seed=_SEED, share=_SHARE)[0]
    log = Recording.from_arrays(
        x=flight.x,
        times=flight.times,
        label=flight.label,
        name=f"Simulated flight (seed {_SEED})",
        channels=flight.channels,
        unit=flight.unit,
    )
    session.set_log(log)
    said = (
        "A simulated flight of a small quadrotor in gusts, not a recording: its velocity with sensor noise, and its "
        "true acceleration as the label."
    )
    return {"log": logs.summary(log), "messages": [said]}


def measured(session: Holder, fields: Fields) -> Reply:
    """Step, slope and noise of one channel of the open log, for the assumptions of the design."""
    log = session.log
    if log is None:
        raise ValueError("no log is open: open one, or the example")
    channel = fields.integer("channel", 0, log.n_x - 1) if "channel" in fields else 0
    part = log if log.n <= _MOST_MEASURED else log.segment(0, _MOST_MEASURED)
    first, last = part.times[0], part.times[-1]
    over = (
        f"{log.channels[channel]} of {log.name or 'the log'}, {part.n} samples, {first:.6g} s to {last:.6g} s"
    )
    inertia = part.inertia
    if inertia is not None and inertia.ndim == 3:
        raise ValueError("a full inertia couples the channels: the noise of one alone cannot be told")
    if inertia is not None and inertia.ndim:
        inertia = inertia[..., channel] if inertia.ndim == 1 else inertia[:, [channel]]
    one = Recording.from_arrays(
        x=part.x[:, [channel]],
        times=part.times,
        g=None if part.g is None else part.g[:, [channel]],
        inertia=inertia,
    )
    found = smooth_label(one)
    noise, walk = float(found.noise[0]), float(found.walk[0])
    force = found.recording.label if part.label is None else part.label[:, [channel]]
    assert force is not None
    gamma = force[:, 0] if part.f_theta is None else force[:, 0] - part.f_theta[:, channel]
    # The smoother's own resolution, at which it begins to take changes of f for noise.
    span = math.sqrt(noise * math.sqrt(log.dt) / walk) if noise > 0.0 and walk > 0.0 else log.dt
    steps = min(max(1, round(span / log.dt)), part.n - 1)
    slope = float(
        np.max(np.abs((gamma[steps:] - gamma[:-steps]) / (part.times[steps:] - part.times[:-steps])))
    )
    what = "label" if part.label is not None else "f, smoothed from both sides,"
    minus = " − f_θ" if part.f_theta is not None else ""
    return {
        "dt": float(f"{log.dt:.6g}"),
        "slope": float(f"{slope:.4g}"),
        "noise": float(f"{noise:.4g}"),
        "messages": [
            f"Over {over}: step {log.dt:.4g} s; noise of M x {noise:.3g}, the likeliest white noise; largest slope of "
            f"the {what}{minus} {slope:.3g}, as changes over {steps * log.dt:.3g} s."
        ],
    }
