"""An FMU written by hand for the tests of this folder."""

from __future__ import annotations

import pytest
from foreign_fmus import oscillator


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
