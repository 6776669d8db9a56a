"""FMUs of the tests are compiled quickly; CI compiles them as users do as well."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module", autouse=True)
def _compiled_quickly(quick_compiler: None) -> None:
    """For every file of this folder."""
