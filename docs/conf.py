"""Settings of the site: `python -m sphinx -c docs . build/site` from the top of the checkout.

The checkout itself is the source folder, so that notebooks, pictures and the models' pages stay where they are and
links between them hold in the checkout as on the site. The result asks nothing of other machines.
"""

from __future__ import annotations

import importlib
import inspect
import os
import re
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path

from docutils import nodes
from docutils.nodes import Element
from latex2mathml.converter import convert
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.domains.python import PythonDomain
from sphinx.environment import BuildEnvironment
from sphinx.errors import ExtensionError
from sphinx.util.nodes import make_refnode
from sphinx.writers.html5 import HTML5Translator

import phyfilter_ctl

ROOT = Path(__file__).resolve().parents[1]

project = "phyfilter-ctl"
author = "the phyfilter-ctl authors"
copyright = f"2026, {author}"
version = release = phyfilter_ctl.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
root_doc = "docs/index"
include_patterns = [
    "docs/**",
    "notebooks/*.py",
    "models/*/README.md",
    "fmus/README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
]
exclude_patterns = [
    "docs/conf.py",
    "docs/drawings.py",
    "docs/screenshots.py",
    ".*",
    "build",
    "dist",
    "out",
    "**/__pycache__",
]
nitpicky = True
# Types in docstrings are prose such as "(N, n_x) array"; only explicit roles must lead somewhere.
nitpick_ignore_regex = [("py:(class|obj)", r".*")]

myst_enable_extensions = ["dollarmath", "attrs_inline", "deflist"]
myst_heading_anchors = 3
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "build" / "notebooks")
nb_execution_raise_on_error = True
nb_execution_timeout = 300
# Words in the types of arguments that also name an attribute somewhere.
suppress_warnings = ["ref.python", "ref.footnote"]  # sources are listed, not cited
nb_merge_streams = True
nb_output_stderr = "error"  # a warning would be shown to the reader

napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"

html_theme = "furo"
html_title = "phyfilter-ctl"
html_math_renderer = "mathml"
html_copy_source = False
html_extra_path = ["_root"]
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}


def _inline(self: HTML5Translator, node: nodes.math) -> None:
    self.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _block(self: HTML5Translator, node: nodes.math_block) -> None:
    self.body.append(self.starttag(node, "div", CLASS="math"))
    self.body.append(convert(node.astext(), display="block") + "</div>\n")
    raise nodes.SkipNode


def _places() -> dict[int, str]:
    """Where the public objects stand on the site: in the first room that names them in ``__all__``."""
    found: dict[int, str] = {}
    for page in sorted((ROOT / "docs" / "reference").glob("*.md")):
        if page.stem != "index":
            room = importlib.import_module(f"phyfilter_ctl.{page.stem}")
            for name in room.__all__:
                found.setdefault(id(getattr(room, name)), f"{room.__name__}.{name}")
    return found


def _candidates(target: str, module: str, holder: str | None) -> Iterator[str]:
    """Full names of documented things that a name in a docstring may mean, the nearest first."""
    names = target.removeprefix("phyfilter_ctl.").split(".")
    for chain in ([holder, *names], names) if holder else (names,):
        for i, name in enumerate(chain):
            inner = ".".join(["phyfilter_ctl", *chain[:i]])
            for home in (module, inner, "phyfilter_ctl", *ROOMS):
                thing, rest = getattr(sys.modules.get(home), name, None), chain[i + 1 :]
                owners = inspect.getmro(thing) if inspect.isclass(thing) and rest else (thing,)
                yield from (".".join([PLACES[id(owner)], *rest]) for owner in owners if id(owner) in PLACES)
    for depth in range(len(names), 0, -1):  # a room, or an inner module of one
        yield ".".join(["phyfilter_ctl", *names[:depth]])
    if f"{module}.{target}" in sys.modules:
        yield module


def _resolve(app: Sphinx, env: BuildEnvironment, node: pending_xref, content: Element) -> Element | None:
    """Lead names as users import them, and those that another module gives a class, to the page of their room."""
    if node.get("refdomain") != "py":
        return None
    documented = env.domains.python_domain.objects
    for name in _candidates(node["reftarget"], node.get("py:module") or "", node.get("py:class")):
        if name in documented:
            place = documented[name]
            return make_refnode(app.builder, node["refdoc"], place.docname, place.node_id, content, name)
    return None


def _single_pages(app: Sphinx) -> None:
    """Write one page for every public name, beside those of the rooms, which link to them."""
    GENERATED.mkdir(parents=True, exist_ok=True)
    pages, seen = {}, set()
    for room, options in _rooms():
        for name in importlib.import_module(room).__all__:
            thing = getattr(importlib.import_module(room), name)
            kind = "class" if inspect.isclass(thing) else "function" if inspect.isroutine(thing) else "data"
            # In no table of contents: every page would carry all of their names.
            lines = [":orphan:", "", name, "=" * len(name), "", f".. auto{kind}:: {room}.{name}"]
            lines += [f"   {option}" for option in options] if kind == "class" else []
            lines += ["   :no-index:"] if id(thing) in seen else []  # offered by an earlier room too
            seen.add(id(thing))
            pages[_page_of(room, name) + ".rst"] = "\n".join([*lines, ""])
    for name, (_, text) in _helps().items():
        shown = "\n".join(f"   {line}".rstrip() for line in text.splitlines())
        lines = [":orphan:", "", name, "=" * len(name), "", ".. code-block:: text", "", shown, ""]
        pages[_command_page(name) + ".rst"] = "\n".join(lines)
    for path in set(GENERATED.glob("*.rst")) - {GENERATED / name for name in pages}:
        path.unlink()
    for name, text in pages.items():
        if not (GENERATED / name).is_file() or (GENERATED / name).read_text(encoding="utf-8") != text:
            (GENERATED / name).write_text(text, encoding="utf-8")


def _drawings(app: Sphinx) -> None:
    """Draw the block diagrams of pages and docstrings anew."""
    runpy.run_path(str(ROOT / "docs" / "drawings.py"))["write"]()


def _page_of(room: str, name: str) -> str:
    return f"{room.partition('.')[2]}-{name}"


def _rooms() -> Iterator[tuple[str, list[str]]]:
    """Rooms that have a page, with the options for their members."""
    for page in sorted((ROOT / "docs" / "reference").glob("*.md")):
        for found in AUTOMODULE.finditer(page.read_text(encoding="utf-8")):
            yield found[1], [option.strip() for option in found[2].splitlines()]


def _fill_in(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put a list of names for the members of a room, and the commands' help into their page."""
    if docname == "docs/commands":
        source[0] = source[0].replace("% COMMANDS\n", _commands())
    elif docname.startswith("docs/reference/"):
        source[0] = AUTOMODULE.sub(_listed, source[0])


def _listed(found: re.Match[str]) -> str:
    """The module's own words, then a line for each of its names, which leads to its page, functions first."""
    room = importlib.import_module(found[1])
    called = [name for name in room.__all__ if inspect.isroutine(getattr(room, name))]
    types = [name for name in room.__all__ if inspect.isclass(getattr(room, name))]
    parts = {
        "Functions": sorted(called, key=lambda name: name not in phyfilter_ctl.__all__),
        "Classes": [name for name in types if name in phyfilter_ctl.__all__],
        "Types of arguments and answers": [name for name in types if name not in phyfilter_ctl.__all__],
        "Constants and named types": [name for name in room.__all__ if name not in {*called, *types}],
    }
    lines = [f".. automodule:: {found[1]}", ""]
    for title, names in parts.items():
        lines += [f".. rubric:: {title}", ""] if names else []
        for name in names:
            said = "" if title.startswith("Constants") else _first_sentence(getattr(room, name))
            lines += [
                f":doc:`{name} <generated/{_page_of(found[1], name)}>`",
                f"    {said or 'See its page.'}",
                "",
            ]
    return "\n".join(lines)


def _first_sentence(thing: object) -> str:
    """Without marks, which may lead nowhere from another page."""
    text = " ".join((inspect.getdoc(thing) or "").partition("\n\n")[0].split())
    text = text.replace("``", "")
    text = re.sub(r":\w+(?::\w+)?:`~?([^`<]*?)(?: <[^`]*>)?`", r"\1", text)
    return re.sub(r"([*|_`\\])", r"\\\1", text)


def _commands() -> str:
    """A line for every command, which leads to its page."""
    lines = [
        f"[`{name}`](reference/generated/{_command_page(name)}.rst)\n: {said}\n"
        for name, (said, _) in _helps().items()
    ]
    return "\n".join(lines)


def _command_page(name: str) -> str:
    return "command-" + name.replace(" ", "-")


def _helps() -> dict[str, tuple[str, str]]:
    """Of every command, the first sentence of its help, and the whole, as the terminal shows it."""
    from phyfilter_ctl.cli import describe_commands

    os.environ["COLUMNS"], os.environ["NO_COLOR"] = "100", "1"
    found: dict[str, tuple[str, str]] = {}
    for name, text in describe_commands().items():
        paragraphs = [" ".join(part.split()) for part in text.split("\n\n")]
        said = paragraphs[1] if len(paragraphs) > 1 else ""
        first = (
            re.split(r"(?<=[.!?])\s", said)[0]
            if not said.startswith(("options:", "positional"))
            else "Its options."
        )
        found[name] = re.sub(r"([*|_`\\\[\]])", r"\\\1", first), text.rstrip()
    return found


def _skip(app: Sphinx, what: str, name: str, thing: object, skip: bool, options: object) -> bool | None:
    """Leave out what named tuples say of their fields: the class's docstring has them."""
    return True if str(getattr(thing, "__doc__", "")).startswith("Alias for field number") else None


def _escape(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Keep magnitudes such as |F| from being substitutions, and attributes that share a line together."""
    section, doctest, block = "", False, -1
    for i, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if set(line.strip()) == {"-"}:
            section = lines[i - 1].strip()
        if section == "Attributes" and re.match(r"\s*\w+(, \w+)+ :", line):
            line = ":".join(
                [line.split(":")[0].rstrip().replace(", ", ",\u200b") + " ", line.split(":", 1)[1]]
            )
        doctest = bool(line.strip()) and (doctest or line.lstrip().startswith(">>>"))
        block = -1 if block >= 0 and line.strip() and indent <= block else block
        if not doctest and block < 0:
            parts = line.split("``")
            lines[i] = "``".join(
                part.replace("|", r"\|") if k % 2 == 0 else part for k, part in enumerate(parts)
            )
            block = indent if line.endswith("::") else -1


def _clickable(app: Sphinx, page: str, template: str, context: dict[str, object], tree: object) -> None:
    """Let a click on a picture show its file, in full size."""
    if isinstance(body := context.get("body"), str):
        picture = re.compile(r'(?<!">)(<img [^>]*src="([^"]+)"[^>]*>)')
        context["body"] = picture.sub(r'<a class="image-reference" href="\2">\1</a>', body)


def _stay_offline(app: Sphinx, error: Exception | None) -> None:
    """Refuse a page that would load something from another machine."""
    loads = re.compile(r'<(?:script|img|iframe|link)\b[^>]*(?:src|href)="(?:https?:)?//[^"]*"')
    for page in sorted(Path(app.outdir).rglob("*.html")) if error is None else []:
        if found := loads.search(page.read_text(encoding="utf-8")):
            raise ExtensionError(f"{page}: expected nothing from other machines, got {found.group()}")


PLACES = _places()
AUTOMODULE = re.compile(r"^\.\. automodule:: (\S+)\n((?:   :.*\n)+)", re.M)
GENERATED = ROOT / "docs" / "reference" / "generated"
ROOMS = tuple(dict.fromkeys(place.rpartition(".")[0] for place in PLACES.values()))


def setup(app: Sphinx) -> None:
    """Formulas as MathML, which browsers draw without any script; docstrings as they are meant."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.connect("builder-inited", _single_pages)
    app.connect("builder-inited", _drawings)
    app.connect("source-read", _fill_in)
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-docstring", _escape, priority=100)
    app.connect("missing-reference", _resolve)
    app.connect("html-page-context", _clickable)
    app.connect("build-finished", _stay_offline)
    for field in getattr(PythonDomain.directives["class"], "doc_field_types", ()):
        if field.name == "variable":
            field.label = "Attributes"  # as the docstrings call them
