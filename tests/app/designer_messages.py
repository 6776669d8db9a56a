"""Messages as the front end sends them."""

from __future__ import annotations

import json

from phyfilter_ctl.app.handling import Session, handle


def message_of(
    poles: list[complex],
    *,
    numerator: dict[str, object] | None = None,
    dt: float = 0.002,
    method: str = "exact",
    limits: dict[str, object] | None = None,
    **assume: float,
) -> dict[str, object]:
    usual = {"slope": 1.0, "noise": 1e-3, "ratio": 1.0, "lag": 0.02, "delay": 0.005, "unit": "N"}
    return {
        "poles": [[complex(p).real, complex(p).imag] for p in poles],
        "numerator": numerator or {"kind": "lowpass"},
        "sampling": {"dt": dt, "method": method},
        "assume": usual | assume,
        "limits": limits,
    }


def reply_to(session: Session, op: str, **fields: object) -> dict:
    """The reply after a trip through JSON both ways, as a browser sees it."""
    message = json.loads(json.dumps({"id": 7, "op": op, **fields}))
    reply = json.loads(json.dumps(handle(session, message), allow_nan=False))
    assert reply["id"] == 7
    return reply


def answered(session: Session, op: str, **fields: object) -> dict:
    reply = reply_to(session, op, **fields)
    assert reply["ok"], reply["error"]
    assert reply["op"] == op
    return reply


def refused(session: Session, op: str, **fields: object) -> dict:
    reply = reply_to(session, op, **fields)
    assert not reply["ok"]
    assert reply["error"]
    return reply
