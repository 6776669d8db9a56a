"""FMUs of the tests are compiled quickly; CI compiles them as users do as well."""

from __future__ import annotations

import pytest
from foreign_fmus import oscillator


@pytest.fixture(scope="module", autouse=True)
def _compiled_quickly(quick_compiler: None) -> None:
    """For every file of this folder."""


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """A function that gives an oscillator FMU written by hand, each kind built once a module."""
    folder = tmp_path_factory.mktemp("foreign")
    made = {}

    def get(fmi="2.0", **options):
        key = repr((fmi, options))
        if key not in made:
            made[key] = oscillator(folder, fmi, name=f"oscillator_{len(made)}", **options)
        return made[key]

    return get
