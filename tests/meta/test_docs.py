"""The site's sources: every public name is on it, every link and name leads somewhere, the citation is valid."""

import importlib
import json
import pkgutil
import re
import tomllib
from pathlib import Path

import pytest

import phyfilter_ctl as pf

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *DOCS.rglob("*.md"),
        *ROOT.glob("models/*/README.md"),
        ROOT / "fmus/README.md",
        *ROOT.glob("notebooks/*.py"),
    ]
)
# The last numbered equation of the paper.
LAST_EQUATION = 44


def rooms():
    """Modules that have a page of the reference."""
    named = [page.stem for page in (DOCS / "reference").glob("*.md") if page.stem != "index"]
    return {name: importlib.import_module(f"phyfilter_ctl.{name}") for name in named}


def test_every_public_name_is_in_the_reference():
    shown = {id(getattr(room, name)) for room in rooms().values() for name in room.__all__}
    assert not [name for name in pf.__all__ if id(getattr(pf, name)) not in shown]


def test_every_room_has_its_page():
    """All but the command line, which describes itself."""
    public = {info.name for info in pkgutil.iter_modules(pf.__path__) if not info.name.startswith("_")}
    with_names = {
        name for name in public if hasattr(importlib.import_module(f"phyfilter_ctl.{name}"), "__all__")
    }
    assert with_names - {"cli"} <= set(rooms())


@pytest.mark.parametrize("name", sorted(rooms()))
def test_page_shows_its_room(name):
    text = (DOCS / "reference" / f"{name}.md").read_text()
    assert f".. automodule:: phyfilter_ctl.{name}\n   :members:" in text
    assert re.search(rf"^{re.escape(name)}$", (DOCS / "reference" / "index.md").read_text(), re.M)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files(page):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.S)
    links = [link.split("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", text)]
    local = [link for link in links if link and not re.match(r"[a-z]+:", link)]
    assert not [link for link in local if not (page.parent / link).exists()]
    # The site takes a Python file for a page, and has those of the notebooks alone.
    scripts = [
        link
        for link in local
        if link.endswith(".py") and "notebooks" not in (page.parent / link).resolve().parts
    ]
    assert not scripts, "name them in the text"


def test_index_lists_notebooks_and_systems():
    listed = set(re.findall(r"^/(\S+)$", (DOCS / "index.md").read_text(), re.M))
    there = {str(path.relative_to(ROOT).with_suffix("")) for path in ROOT.glob("notebooks/*.py")}
    assert there | {"models/*/README"} <= listed
    assert not [name for name in listed if not list(ROOT.glob(f"{name}.*"))]


def test_gallery_shows_every_picture_of_the_models():
    text = (DOCS / "gallery.md").read_text()
    missing = [p for p in ROOT.glob("models/*/*.png") if f"(../{p.relative_to(ROOT)})" not in text]
    assert not missing, "add them to docs/gallery.md, with the command that draws them"


def resolve(name):
    parts = name.split(".")
    for i in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:i]))
        except ImportError:
            continue
        for part in parts[i:]:
            thing = getattr(thing, part)
        return thing
    raise AssertionError(name)


def test_equations_lead_to_documented_names():
    names = re.findall(r"\{py:\w+\}`~([\w.]+)`", (DOCS / "equations.md").read_text())
    assert len(names) > 40
    for name in names:
        assert resolve(name) is not None
        room, member = name.split(".")[1:3]
        assert member in rooms()[room].__all__, name


def test_no_equation_of_the_paper_is_left_out():
    text = (DOCS / "equations.md").read_text()
    first = re.findall(r"^\| ([^|]*)\|", text, re.M)
    numbers = {int(n) for cell in first for n in re.findall(r"\((\d+)\)", cell)}
    assert numbers == set(range(1, LAST_EQUATION + 1))
    tests = {Path(name).name for name in re.findall(r"`(?:tests/identities/)?(test_\w+\.py)`", text)}
    assert tests
    assert tests <= {path.name for path in (ROOT / "tests" / "identities").glob("*.py")}


def test_policy_states_the_versions_of_files():
    from phyfilter_ctl.filter import live_state
    from phyfilter_ctl.filterfile import document
    from phyfilter_ctl.fmi import recipes
    from phyfilter_ctl.learned import _files
    from phyfilter_ctl.robot import document as robot

    text = (DOCS / "policy.md").read_text()
    for module in (document, live_state, recipes, _files, robot):
        row = next(line for line in text.splitlines() if f'"{module.FORMAT}"' in line)
        assert row.rstrip(" |").endswith(f" {module.VERSION}")
    header = (ROOT / "phyfilter_ctl/codegen/runtime/pf_filter.h").read_text()
    version = re.findall(r"#define PF_FILTER_FORMAT (\d+)u", header)[0]
    row = next(line for line in text.splitlines() if "PF_FILTER_FORMAT" in line)
    assert row.rstrip(" |").endswith(f" {version}")


# Of the Citation File Format 1.2.0 (citation-file-format.github.io), what is used here, and nothing else allowed.
TEXT = {"type": "string", "minLength": 1}
PERSON = {
    "type": "object",
    "properties": {"family-names": TEXT, "given-names": TEXT, "affiliation": TEXT},
    "required": ["family-names", "given-names"],
    "additionalProperties": False,
}
ENTITY = {
    "type": "object",
    "properties": {"name": TEXT},
    "required": ["name"],
    "additionalProperties": False,
}
AUTHORS = {"type": "array", "minItems": 1, "uniqueItems": True, "items": {"anyOf": [PERSON, ENTITY]}}
REFERENCE = {
    "type": "object",
    "properties": {
        "type": {"const": "article"},
        "title": TEXT,
        "authors": AUTHORS,
        "url": {"type": "string", "pattern": "^https://"},
        "repository-code": {"type": "string", "pattern": "^https://"},
        "scope": TEXT,
    },
    "required": ["authors", "title", "type"],
    "additionalProperties": False,
}
CITATION = {
    "type": "object",
    "properties": {
        "cff-version": {"const": "1.2.0"},
        "message": TEXT,
        "type": {"const": "software"},
        "title": TEXT,
        "abstract": TEXT,
        "authors": AUTHORS,
        "version": TEXT,
        "date-released": {"type": "string", "pattern": r"^\d{4}-\d{2}-\d{2}$"},
        "license": TEXT,
        "keywords": {"type": "array", "minItems": 1, "uniqueItems": True, "items": TEXT},
        "references": {"type": "array", "minItems": 1, "uniqueItems": True, "items": REFERENCE},
    },
    "required": ["authors", "cff-version", "message", "title"],
    "additionalProperties": False,
}


def test_citation_is_valid_and_says_what_the_package_says():
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed: CITATION.cff is not read")
    jsonschema = pytest.importorskip(
        "jsonschema", reason="jsonschema is not installed: CITATION.cff is not checked"
    )
    found = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    jsonschema.validate(json.loads(json.dumps(found)), CITATION)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (found["title"], found["version"], found["license"]) == (
        project["name"],
        project["version"],
        project["license"].split(" AND ")[0],  # ours; what is vendored has others
    )
    assert found["version"] == pf.__version__
    assert found["keywords"] == project["keywords"]
    paper = found["references"][0]
    assert paper["title"] in (ROOT / "README.md").read_text().replace("\n", " ")
    assert len(paper["authors"]) == 11


# What a control engineer would not say, and what the glossary says instead.
REPLACED = {
    r"\bbears?\b|\bbearable\b": "tolerates",
    r"without a bump|\bno bump\b|bump-free": "bumpless",
    r"step answer|answers? to a step|response to a unit step": "step response",
    r"matrix of information": "information matrix",
    r"best-compromise|front of compromises": "Pareto front",
    r"hold of order (zero|one|0|1)": "zero-order hold, first-order hold",
}


@pytest.mark.parametrize("words", REPLACED)
def test_terms_are_those_of_the_glossary(words):
    folders = ("phyfilter_ctl", "models", "notebooks", "docs", "benchmarks", "fmus")
    texts = [
        path
        for folder in folders
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".py", ".md", ".js")
    ]
    found = [
        f"{path.relative_to(ROOT)}: {match[0]}"
        for path in [*texts, *ROOT.glob("*.md")]
        if (match := re.search(words, path.read_text(), re.IGNORECASE))
    ]
    assert not found, f"write {REPLACED[words]!r}"


def test_the_glossary_has_the_terms():
    page = (DOCS / "glossary.md").read_text()
    terms = [term for terms in REPLACED.values() for term in terms.split(", ")]
    assert not [term for term in terms if term not in page]
