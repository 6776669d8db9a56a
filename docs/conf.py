"""Settings of the site: `python -m sphinx -c docs . build/site` from the top of the checkout.

The checkout itself is the source folder, so that notebooks, pictures and the models' pages stay where they are and
links between them hold in the checkout as on the site. The result asks nothing of other machines.
"""

from __future__ import annotations

import importlib
import inspect
import re
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

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
root_doc = "docs/index"
include_patterns = ["docs/**", "notebooks/*.py", "models/*/README.md", "fmus/README.md", "CHANGELOG.md"]
exclude_patterns = ["docs/conf.py", "docs/screenshots.py", ".*", "build", "dist", "out", "**/__pycache__"]
nitpicky = True
# Types in docstrings are prose such as "(N, n_x) array"; only explicit roles must lead somewhere.
nitpick_ignore_regex = [("py:(class|obj)", r".*")]

myst_enable_extensions = ["dollarmath", "attrs_inline"]
myst_heading_anchors = 2
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "build" / "notebooks")
nb_execution_raise_on_error = True
nb_execution_timeout = 300
# Words in the types of arguments that also name an attribute somewhere.
suppress_warnings = ["ref.python"]
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


def _stay_offline(app: Sphinx, error: Exception | None) -> None:
    """Refuse a page that would load something from another machine."""
    loads = re.compile(r'<(?:script|img|iframe|link)\b[^>]*(?:src|href)="(?:https?:)?//[^"]*"')
    for page in sorted(Path(app.outdir).rglob("*.html")) if error is None else []:
        if found := loads.search(page.read_text(encoding="utf-8")):
            raise ExtensionError(f"{page}: expected nothing from other machines, got {found.group()}")


PLACES = _places()
ROOMS = tuple(dict.fromkeys(place.rpartition(".")[0] for place in PLACES.values()))


def setup(app: Sphinx) -> None:
    """Formulas as MathML, which browsers draw without any script; docstrings as they are meant."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.connect("autodoc-process-docstring", _escape, priority=100)
    app.connect("missing-reference", _resolve)
    app.connect("build-finished", _stay_offline)
    for field in getattr(PythonDomain.directives["class"], "doc_field_types", ()):
        if field.name == "variable":
            field.label = "Attributes"  # as the docstrings call them
