"""Every public name is documented down to its arguments, and takes no argument it does not name."""

import ast
import builtins
import enum
import functools
import importlib
import importlib.util
import inspect
import pkgutil
import re
import subprocess
import sys
import typing
from pathlib import Path

import numpy as np
import pytest

import phyfilter_ctl as pf

ROOT = Path(__file__).resolve().parents[2]

ENVIRONMENTS = "phyfilter_ctl.wrappers.environments"  # imported by its name, with the extra gymnasium


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


# What models take from inside rooms: types of signatures, and what stands on simulators and on disk.
INSIDE = {
    "phyfilter_ctl._output",
    "phyfilter_ctl.controllers.joint_torque",
    "phyfilter_ctl.controllers.planner",
    "phyfilter_ctl.fmi.description",
    "phyfilter_ctl.fmi.instance",
    "phyfilter_ctl.plants.algebra",
    "phyfilter_ctl.plants.factory",
    "phyfilter_ctl.plants.legged",
    "phyfilter_ctl.plants.legged.rendering",
    "phyfilter_ctl.plants.legged.simulator",
}


def blocks_of_pages():
    """Python of README and pages, block by block, and notebooks."""
    pages = {path: path.read_text() for path in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]}
    blocks = {path: re.findall(r"^```python\n(.*?)^```", text, re.M | re.S) for path, text in pages.items()}
    return blocks | {path: [path.read_text()] for path in (ROOT / "notebooks").glob("*.py")}


def is_module(name):
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:  # of what is no package
        return False


def imports_of(source):
    """(module, name) of what Python text imports from the library, but for its models."""
    for node in ast.walk(ast.parse(source)):
        module = (node.module or "") if isinstance(node, ast.ImportFrom) and not node.level else ""
        if module.split(".")[0] == "phyfilter_ctl" and not module.startswith("phyfilter_ctl.models"):
            yield from ((module, alias.name) for alias in node.names)


@pytest.mark.parametrize("kind", ["pages", "models"])
def test_what_is_imported_is_listed(kind):
    """Pages, notebooks and models take names that some ``__all__`` has, from where it has them."""
    pages = {path: "\n".join(block) for path, block in blocks_of_pages().items()}
    sources = (
        pages if kind == "pages" else {path: path.read_text() for path in (ROOT / "models").rglob("*.py")}
    )
    wrong = set()
    for path, source in sources.items():
        for module, name in imports_of(source):
            if module == ENVIRONMENTS:
                continue
            listed = getattr(importlib.import_module(module), "__all__", ())
            inner = module.count(".") > 1 and module != "phyfilter_ctl.design.optimal"
            if name not in listed and not is_module(f"{module}.{name}"):
                wrong.add(f"{path.name}: {module} lists no {name}")
            elif (inner or module == "phyfilter_ctl._output") and (kind == "pages" or module not in INSIDE):
                wrong.add(f"{path.name}: {name} is inside {module}")
    assert not wrong, "\n".join(sorted(wrong))


def test_a_package_is_reached_by_its_name_alone():
    code = "import phyfilter_ctl as pf; print(pf.fmi.Master.__name__, pf.baselines.compare.__name__)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["Master", "compare"]
