"""What both hosts of the designer load: its ES modules in ``web/``, joined into one.

A notebook takes one module, as text; a page would ask for forty, and be twice as long in starting. So both get the
same one, joined from the sources when it is asked for. That needs no node and leaves no built file that could fall
behind its sources, and a checkout, an editable install and a wheel are the same to it. It takes milliseconds, because
the modules keep to two lines:

* ``import { a, b } from "./other.js";``,
* ``export`` before a function, a class or a ``const``; ``export default`` once, at the end of the first module.

Each module becomes a function that is called once, so that names stay its own.

The style sheet is ``designer.css``, which holds colours and what all parts share, and after it ``styles/`` by name.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

__all__ = ["WEB", "joined", "sent"]

WEB = Path(__file__).with_name("web")

_IMPORT = re.compile(r'^import \{\s*([\w$,\s]+?),?\s*\} from "(\.[\w./-]+)";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const) ([\w$]+))", re.MULTILINE)
_DEFAULT = re.compile(r"^export default (?=[^;]+;\s*\Z)", re.MULTILINE)
_OTHER = re.compile(r"^(?:import|export)\b.*", re.MULTILINE)
_DYNAMIC = re.compile(r"import[.(].*")


def sent(name: str) -> str:
    """Text of a file as a host gets it: the modules as one, the style sheets as one, all else as it is.

    Parameters
    ----------
    name : {"designer.js", "designer.css", "page.html", "page.js", "page.css"}

    Returns
    -------
    str
    """
    if name == "designer.js":
        return joined(WEB, name)
    parts = [WEB / name, *(sorted((WEB / "styles").glob("*.css")) if name == "designer.css" else ())]
    return "\n".join(part.read_text(encoding="utf-8") for part in parts)


def joined(folder: Path, first: str) -> str:
    """One ES module out of a module and all that it imports.

    Parameters
    ----------
    folder : Path
        Where the modules are.
    first : str
        Name of the module whose default export the result has.

    Returns
    -------
    str
        Text of the module; the same for the same files.

    Raises
    ------
    ValueError
        If an import or an export has another form than this can join, a name is not exported, or modules import each
        other in a circle.
    OSError
        If a module cannot be read.
    """
    parts: dict[str, str] = {}
    exports: dict[str, tuple[str, ...]] = {}

    def add(name: str, path: tuple[str, ...]) -> None:
        if name in path:
            raise ValueError(f"modules import each other in a circle: {' -> '.join([*path, name])}")
        if name in exports:
            return
        text = (folder / name).read_text(encoding="utf-8")
        imports = []
        for names, source in _IMPORT.findall(text):
            target = posixpath.normpath(posixpath.join(posixpath.dirname(name), source))
            add(target, (*path, name))
            wanted = [each.strip() for each in names.split(",")]
            if unknown := [each for each in wanted if each not in exports[target]]:
                raise ValueError(f"{name} imports {', '.join(unknown)}, which {target} does not export")
            imports.append(f"const {{ {', '.join(wanted)} }} = modules[{_quoted(target)}];")
        parts[name] = "\n".join([*imports, _body(name, text, default=not path)])
        exports[name] = tuple(_EXPORT.findall(text))

    add(first, ())
    lines = ["const modules = {};"]
    for name, part in parts.items():
        given = "" if name == first else f"return {{ {', '.join(exports[name])} }};\n"
        lines.append(f"modules[{_quoted(name)}] = (() => {{\n{part}{given}}})();")
    return "\n".join([*lines, f"export default modules[{_quoted(first)}];", ""])


def _body(name: str, text: str, *, default: bool) -> str:
    """A module without the lines that this file knows, which are all that it may have of their kind."""
    body = _EXPORT.sub("", _IMPORT.sub("", text))
    if default:
        body, count = _DEFAULT.subn("return ", body)
        if count != 1:
            raise ValueError(f"{name}: expected one 'export default' at the end, got {count}")
    if other := _OTHER.search(body) or _DYNAMIC.search(body):
        raise ValueError(
            f"{name}: cannot join {other[0].strip()!r}: write 'import {{ a, b }} from \"./other.js\";', "
            "or 'export' before a function, a class or a const"
        )
    return body


def _quoted(name: str) -> str:
    return f'"{name}"'
