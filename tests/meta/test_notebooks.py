"""Every notebook runs from top to bottom; its last cell, which the site runs and does not show, asserts its figures."""

from pathlib import Path

import pytest

jupytext = pytest.importorskip("jupytext", reason="jupytext is not installed: notebooks are not executed")
nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: notebooks are not executed")
pytest.importorskip("ipykernel", reason="ipykernel is not installed: notebooks are not executed")

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.py"))


def test_all_are_percent_files():
    """Text that can be compared and reviewed, without outputs, in the order of reading."""
    assert not list(FOLDER.glob("*.ipynb"))
    assert [int(path.stem.split("_")[0]) for path in NOTEBOOKS] == list(range(1, len(NOTEBOOKS) + 1))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_title_first_and_figures_last(path):
    notebook = jupytext.read(path)
    assert notebook.cells[0].source.startswith("# "), "a notebook begins with its title"
    assert "assert" in notebook.cells[-1].source
    assert notebook.cells[-1].metadata.get("tags") == ["remove-cell"], "readers need no test"
    assert not any("assert " in cell.source for cell in notebook.cells[:-1] if cell.cell_type == "code")


@pytest.mark.slow  # CI leaves it out: the site executes every notebook, and fails as this does
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
# The kernel's client library warns about its own event loop and file descriptors; the code under test runs elsewhere.
@pytest.mark.filterwarnings("default")
def test_notebook_runs(path):
    notebook = jupytext.read(path)
    try:
        nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    except nbclient.exceptions.CellExecutionError as error:
        if error.ename == "CompilerError" and error.evalue.startswith("no C compiler"):
            pytest.skip(error.evalue)
        raise
    printed = [
        out for cell in notebook.cells for out in cell.get("outputs", ()) if out.output_type == "stream"
    ]
    assert not [out.text for out in printed if out.name == "stderr"], "warnings are shown to the reader"
