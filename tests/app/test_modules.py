"""The designer's modules, and what they become in one piece."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from phyfilter_ctl.app.modules import WEB, joined, sent

NODE = shutil.which("node") or shutil.which("node", path=str(Path(sys.executable).parent))
needs_node = pytest.mark.skipif(NODE is None, reason="node is not installed")
FIRST = 'import {{ {0} }} from "./other.js";\nexport default {{ {0} }};\n'


def write(folder: Path, modules: dict[str, str]) -> Path:
    for name, text in modules.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def value(text: str, folder: Path) -> object:
    """The default export of a module, as JSON has it."""
    assert NODE is not None
    (folder / "whole.mjs").write_text(text, encoding="utf-8")
    script = (
        "import whole from './whole.mjs';"
        " console.log(JSON.stringify(whole, (_, v) => (v instanceof Function ? 'function' : v)));"
    )
    command = [NODE, "--input-type=module", "-e", script]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_every_module_is_reached_and_every_import_leads_somewhere():
    reached, waiting = set(), ["page.js"]
    while waiting:
        name = waiting.pop()
        reached.add(name)
        path = WEB / name
        sources = re.findall(
            r'^import .*? from "(.*?)";$', path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
        )
        found = {str((path.parent / source).resolve().relative_to(WEB)) for source in sources}
        waiting += sorted(found - reached)
    assert reached == {path.relative_to(WEB).as_posix() for path in WEB.rglob("*.js")}


def test_every_style_sheet_of_a_part_is_sent_once_after_what_all_share():
    text = sent("designer.css")
    parts = [(WEB / "designer.css").read_text(encoding="utf-8")]
    parts += [path.read_text(encoding="utf-8") for path in sorted((WEB / "styles").iterdir())]
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
    assert len(text) == sum(map(len, parts)) + len(parts) - 1


def test_nothing_is_asked_of_other_machines():
    for path in [*WEB.rglob("*.js"), *WEB.rglob("*.css"), *WEB.rglob("*.html")]:
        text = path.read_text(encoding="utf-8")
        for line in text.splitlines():
            assert "://" not in line or "http://www.w3.org/2000/svg" in line, line
        assert "innerHTML" not in text
        assert "eval(" not in text
        assert path.suffix != ".css" or "@import" not in text


@needs_node
def test_the_designer_is_one_module(tmp_path):
    whole = sent("designer.js")
    assert whole == sent("designer.js")
    assert not re.search(r"^\s*(import|export (?!default))", whole, re.MULTILINE)
    assert value(whole, tmp_path) == {"render": "function"}


@needs_node
def test_names_of_a_module_stay_its_own(tmp_path):
    modules = {
        "designer.js": 'import {\n  one,\n  Two,\n} from "./deep/a.js";\nimport { three } from "./b.js";\n'
        "const hidden = 4;\nexport default { sum: one() + new Two().two + three + hidden };\n",
        "deep/a.js": 'import { three } from "../b.js";\nconst hidden = 100;\n'
        "export function one() {\n  return hidden + three;\n}\nexport class Two {\n  two = 20;\n}\n",
        "b.js": "const hidden = 3000;\nexport const three = hidden;\n",
    }
    assert value(joined(write(tmp_path, modules), "designer.js"), tmp_path) == {"sum": 6124}


@pytest.mark.parametrize(
    ("other", "says"),
    [
        ("export const b = 1;\n", "designer.js imports a, which other.js does not export"),
        ("export let a = 1;\n", "other.js: cannot join 'export let a = 1;'"),
        ("export const a = 1;\nexport { a as b };\n", "other.js: cannot join 'export { a as b };'"),
        ('import * as b from "./b.js";\nexport const a = 1;\n', "cannot join 'import"),
        ('export const a = () => import("./b.js");\n', "cannot join 'import"),
        (
            'import { c } from "./designer.js";\nexport const a = 1;\n',
            "circle: designer.js -> other.js -> designer.js",
        ),
    ],
)
def test_what_cannot_be_joined_is_named(tmp_path, other, says):
    folder = write(tmp_path, {"designer.js": FIRST.format("a"), "other.js": other})
    with pytest.raises(ValueError, match=re.escape(says)):
        joined(folder, "designer.js")


def test_the_first_module_has_one_default_export(tmp_path):
    write(tmp_path, {"designer.js": "const a = 1;\n"})
    with pytest.raises(ValueError, match="one 'export default' at the end, got 0"):
        joined(tmp_path, "designer.js")
