"""Every public name is documented down to its arguments, and takes no argument it does not name."""

import importlib
import inspect
import pkgutil
import re

import numpy as np
import pytest

import phyfilter_ctl as pf


def public_modules():
    """The rooms: what a user imports from. Modules inside a room are its own affair."""
    for info in pkgutil.iter_modules(pf.__path__, "phyfilter_ctl."):
        if not info.name.rsplit(".", 1)[1].startswith("_"):
            yield importlib.import_module(info.name)


def public_callables():
    seen = set()
    for module in [pf, *public_modules()]:
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            home = getattr(thing, "__module__", "")
            if not callable(thing) or not home.startswith("phyfilter_ctl") or thing in seen:
                continue
            seen.add(thing)
            yield f"{home}.{name}", thing
            if inspect.isclass(thing) and not getattr(thing, "_is_protocol", False):
                for method, value in vars(thing).items():
                    function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
                    if not method.startswith("_") and inspect.isfunction(function):
                        yield f"{home}.{name}.{method}", function


CALLABLES = dict(public_callables())


@pytest.mark.parametrize("name", CALLABLES)
def test_arguments_are_documented(name):
    thing = CALLABLES[name]
    text = inspect.getdoc(thing) or ""
    assert text, f"{name} has no docstring"
    if inspect.isclass(thing) and issubclass(thing, tuple):
        return
    try:
        signature = inspect.signature(thing)
    except ValueError:
        return
    missing = [
        parameter
        for parameter, detail in signature.parameters.items()
        if parameter not in ("self", "cls")
        and detail.kind not in (detail.VAR_KEYWORD, detail.VAR_POSITIONAL)
        and not re.search(rf"\b{re.escape(parameter)}\b", text)
    ]
    assert not missing, f"{name}: not in the docstring: {missing}"
    swallowed = [p for p, d in signature.parameters.items() if d.kind is d.VAR_KEYWORD]
    assert not swallowed or inspect.isclass(thing), f"{name} swallows misspelt keywords"


@pytest.mark.parametrize("name", [name for name, thing in CALLABLES.items() if inspect.isfunction(thing)])
def test_misspelt_keywords_fail(name):
    thing = CALLABLES[name]
    with pytest.raises(TypeError):
        inspect.signature(thing).bind_partial(no_such_keyword=1)


def test_names_the_user_was_promised():
    promised = {"PhyFilter", "SampledPhyFilter", "place_poles", "lowpass", "bandpass", "frequency_response"}
    assert promised | {"phyfilter_block", "FlightLog"} <= set(pf.__all__)
    assert set(pf.__all__) == set(dict.fromkeys(pf.__all__)), "a name stands twice"


def test_import_is_light():
    """Importing the package pulls in no training library and draws nothing."""
    import subprocess
    import sys

    code = "import sys, phyfilter_ctl; print('sklearn' in sys.modules)"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "False"


def test_numpy_state_is_left_alone():
    before = np.geterr()
    pf.PhyFilter([400.0, 40.0]).sampled(0.01).run(np.zeros((10, 1)))
    assert np.geterr() == before
