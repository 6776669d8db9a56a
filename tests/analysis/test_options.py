"""The rule for options: counted, refused or named, whatever is added to ``Sampling``."""

from __future__ import annotations

from options_table import ANALYSES, CHANGES, cell, options

# Signals from outside the loop, or what only labels or treats bad samples.
_NO_EFFECT = {
    "units": set(ANALYSES),
    "channels": set(ANALYSES),
    "nonfinite": set(ANALYSES),
    "precision": set(ANALYSES) - {"error_bound"},
    # Both are known, whatever they are between the samples: they leave no residual but in the bound.
    "f_theta": set(ANALYSES) - {"error_bound"},
    "g": {"frequency_response", "error_variance"},
    # The circle criterion is for what any limit leaves of the command, which such a filter is told.
    "g_limit": {"saturation_margin"},
}
# Loops are per unit of M_hat, along what E spans.
_LOOPS = {"margins, inner loop", "margins, complete loop", "saturation_margin", "inertia_tolerance"}
_NO_EFFECT |= {"inertia": _LOOPS, "E": _LOOPS}
_MUST_COUNT = ("error_bound", "error_variance", "tracking_error, bounds", "tracking_error, spectra")


def test_every_option_has_a_change_to_try():
    assert set(options()) == set(CHANGES)


def test_every_option_is_counted_refused_or_named():
    found = {(option, name): cell(name, option) for option in options() for name in ANALYSES}
    silent = {key for key, what in found.items() if what == "-"}
    allowed = {(option, name) for option, names in _NO_EFFECT.items() for name in names}
    assert silent == allowed
    assert all(found[option, name] == "counted" for option in ("E", "inertia") for name in _MUST_COUNT)
    assert all(found["delay", name] == "counted" for name in (*_MUST_COUNT, *_LOOPS))
    assert all(found[option, "tracking_error, bounds"] == "counted" for option in ("limit", "g_limit"))
