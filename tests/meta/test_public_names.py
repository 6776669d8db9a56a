"""Every public name is documented down to its arguments, and takes no argument it does not name."""

import builtins
import enum
import functools
import importlib
import inspect
import pkgutil
import re
import sys
import typing

import numpy as np
import pytest

import phyfilter_ctl as pf


def public_modules():
    """The rooms: what a user imports from. Modules inside a room are its own affair."""
    for info in pkgutil.iter_modules(pf.__path__, "phyfilter_ctl."):
        if not info.name.rsplit(".", 1)[1].startswith("_"):
            yield importlib.import_module(info.name)
    yield importlib.import_module("phyfilter_ctl.design.optimal")  # has a page of its own


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
                own = [base for base in thing.__mro__ if base.__module__.startswith("phyfilter_ctl")]
                for method, value in {k: v for base in own[::-1] for k, v in vars(base).items()}.items():
                    function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
                    if not method.startswith("_") and inspect.isfunction(function):
                        yield f"{home}.{name}.{method}", function


CALLABLES = dict(public_callables())


ROOMS = sorted({name.split(".")[1] for name in CALLABLES})


def of_room(room):
    return {name: thing for name, thing in CALLABLES.items() if name.split(".")[1] == room}


def wrong_with_arguments(thing):
    text = inspect.getdoc(thing) or ""
    if not text:
        return "no docstring"
    if inspect.isclass(thing) and issubclass(thing, tuple | enum.Enum):
        return ""
    try:
        signature = inspect.signature(thing)
    except ValueError:
        return ""
    missing = [
        parameter
        for parameter, detail in signature.parameters.items()
        if parameter not in ("self", "cls")
        and detail.kind not in (detail.VAR_KEYWORD, detail.VAR_POSITIONAL)
        and not re.search(rf"\b{re.escape(parameter)}\b", text)
    ]
    if missing:
        return f"not in the docstring: {missing}"
    swallows = any(detail.kind is detail.VAR_KEYWORD for detail in signature.parameters.values())
    return "swallows misspelt keywords" if swallows and not inspect.isclass(thing) else ""


@pytest.mark.parametrize("room", ROOMS)
def test_arguments_are_documented(room):
    wrong = {name: wrong_with_arguments(thing) for name, thing in of_room(room).items()}
    assert not {name: what for name, what in wrong.items() if what}


@pytest.mark.parametrize("room", ROOMS)
def test_misspelt_keywords_fail(room):
    for thing in filter(inspect.isfunction, of_room(room).values()):
        with pytest.raises(TypeError):
            inspect.signature(thing).bind_partial(no_such_keyword=1)


OTHER_PACKAGES = {
    name: importlib.import_module(package)
    for name, package in {"ca": "casadi", "ct": "control", "sympy": "sympy"}.items()
}


class Names(dict):
    """What a module knows; a name that only type checkers import is the room's of that name, or another package's."""

    def __missing__(self, name):
        if name.startswith("_"):
            raise KeyError(name)
        ours = (thing for thing in CALLABLES.values() if thing.__name__ == name)
        return next(ours, OTHER_PACKAGES.get(name, typing.Any))


def classes_of(annotation):
    if inspect.isclass(annotation):
        yield annotation
    arguments = annotation if isinstance(annotation, list) else typing.get_args(annotation)
    for argument in arguments:
        yield from classes_of(argument)


def annotated(thing):
    """A function; or a class with its bases, and what they have that is public."""
    if not inspect.isclass(thing):
        return [thing]
    own = [base for base in thing.__mro__ if base.__module__.startswith("phyfilter_ctl")]
    members = [
        value for base in own for name, value in vars(base).items() if name[0] != "_" or name == "__init__"
    ]
    inner = {
        property: "fget",
        functools.cached_property: "func",
        classmethod: "__func__",
        staticmethod: "__func__",
    }
    functions = [getattr(value, inner.get(type(value), "__self__"), value) for value in members]
    return own + [function for function in functions if inspect.isfunction(function)]


def test_what_public_names_refer_to_is_public():
    """Classes in the signatures and fields of a room's names are names of a room themselves."""
    public, hidden = set(CALLABLES.values()), set()
    for thing in public:
        for part in annotated(thing):
            names = Names(vars(builtins) | vars(sys.modules[part.__module__]))
            for key, annotation in inspect.get_annotations(part).items():
                text = getattr(annotation, "__forward_arg__", annotation)
                meant = eval(text, {}, names) if isinstance(text, str) else text
                hidden |= set(() if key[0] == "_" else classes_of(meant)) - public
    missing = {f"{each.__module__}.{each.__name__}" for each in hidden}
    missing = sorted(name for name in missing if name.startswith("phyfilter_ctl."))
    assert not missing, f"add them to the __all__ of their rooms: {missing}"


def test_names_the_user_was_promised():
    promised = {"PhyFilter", "SampledPhyFilter", "place_poles", "lowpass", "bandpass", "frequency_response"}
    assert promised | {"phyfilter_block", "Recording"} <= set(pf.__all__)
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
