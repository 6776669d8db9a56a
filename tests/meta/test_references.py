"""Names that docstrings and pages refer to exist, attributes of what a function returns included."""

import ast
import contextlib
import importlib
import inspect
import pkgutil
import re
import typing
import warnings
from pathlib import Path

import pytest

import phyfilter_ctl as pf

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted(ROOT.glob("models/*/README.md"))]
ROLE = re.compile(r":(?:func|meth|attr|class|mod|data|exc|obj):`~?([\w.]+)`")
CODE = re.compile(r"``(.+?)``|`([^`]+)`", re.S)
DOTTED = re.compile(r"(?<![\w./])(?:pf|phyfilter_ctl)\.[A-Za-z_][\w.]*\w(?![\w/-])")


def hints(thing):
    with contextlib.suppress(NameError, TypeError):  # imported for type checkers alone; nothing that has any
        return typing.get_type_hints(thing)
    return {}


def member(thing, names):
    """What the names lead to from there, None if nothing; fields of a class and what properties return count."""
    for name in names:
        if isinstance(thing, property):
            thing = hints(thing.fget).get("return")
        fields = hints(thing) if inspect.isclass(thing) else {}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", DeprecationWarning)  # a name of before is none to refer to
                thing = getattr(thing, name, fields.get(name))
        except DeprecationWarning:
            thing = None
    return thing


def exists(name, places=()):
    """Whether a name leads somewhere from the package, if it begins with that, or else from one of the places."""
    parts = name.split(".")
    if parts[0] in ("pf", "phyfilter_ctl"):
        places, parts = [pf], parts[1:]
        for i in range(len(parts), 0, -1):
            try:
                importlib.import_module(".".join(["phyfilter_ctl", *parts[:i]]))
                break
            except ModuleNotFoundError:
                continue
            except ImportError:  # it is there, but not the extra that it stands on
                return True
    return any(member(place, parts) is not None for place in places)


def made(node):
    """The class or module that an expression stands for where it begins with ``pf.``, else None."""
    if isinstance(node, ast.Name):
        return pf if node.id == "pf" else None
    if isinstance(node, ast.Attribute):
        return member(made(node.value), [node.attr]) if made(node.value) else None
    if isinstance(node, ast.Call) and (function := made(node.func)):
        if inspect.isclass(function):
            return function
        returned = hints(function).get("return")
        return returned if inspect.isclass(returned) else None
    return None


def missing_in_code(code):
    """Attributes in an expression that what they are taken from does not have."""
    missing = [name for name in DOTTED.findall(code) if not exists(name)]
    try:
        tree = ast.parse(" ".join(code.split()), mode="eval")
    except SyntaxError:
        return missing
    taken = [(made(node.value), node.attr) for node in ast.walk(tree) if isinstance(node, ast.Attribute)]
    return missing + [
        f"{getattr(owner, '__name__', owner)}.{name}"
        for owner, name in taken
        if owner and member(owner, [name]) is None
    ]


def documented(module):
    """(what, docstring, class that it is in) of a module's source."""
    tree = ast.parse(Path(module.__file__).read_text())
    waiting = [(tree, None)]
    while waiting:
        node, owner = waiting.pop()
        if isinstance(node, ast.ClassDef):
            owner = getattr(module, node.name, owner)
        yield getattr(node, "name", module.__name__), ast.get_docstring(node) or "", owner
        kinds = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        waiting += [(child, owner) for child in ast.iter_child_nodes(node) if isinstance(child, kinds)]


def modules():
    for info in pkgutil.walk_packages(pf.__path__, "phyfilter_ctl.", onerror=lambda name: None):
        if not info.name.startswith("phyfilter_ctl.models."):
            try:
                yield importlib.import_module(info.name)
            except ImportError:  # of an extra that is not installed
                continue


def test_docstrings_refer_to_what_exists():
    missing, seen = [], 0
    for module in modules():
        parents = module.__name__.split(".")
        rooms = [importlib.import_module(".".join(parents[:i])) for i in range(1, len(parents) + 1)]
        for what, text, owner in documented(module):
            names = ROLE.findall(text)
            seen += len(names)
            missing += [
                (module.__name__, what, name)
                for name in names
                if not exists(name.lstrip("."), [*rooms, *([owner] if owner else [])])
            ]
            for code in CODE.findall(text):
                missing += [(module.__name__, what, name) for name in missing_in_code(code[0] or code[1])]
    assert seen > 200
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_refer_to_what_exists(page):
    text = page.read_text()
    assert not [name for name in DOTTED.findall(text) if not exists(name)]
    spans = CODE.findall(re.sub(r"```.*?```", "", text, flags=re.S))
    assert not [name for code in spans for name in missing_in_code(code[0] or code[1])]


def test_a_wrong_name_is_seen():
    assert missing_in_code("lambda f: pf.error_bound(f, {1: 1.0}).bounds > 0.5") == ["ErrorBound.bounds"]
    assert missing_in_code("pf.error_bound(f, {1: 1.0}).bound") == []
    assert missing_in_code("x: pf.no_such_name") == ["pf.no_such_name"]
    assert not exists("no_such_name", [pf])
