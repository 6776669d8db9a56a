"""Every notebook runs from top to bottom; its last cell asserts its headline figures."""

from pathlib import Path

import pytest

nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: notebooks are not executed")
nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed: notebooks are not executed")
pytest.importorskip("ipykernel", reason="ipykernel is not installed: notebooks are not executed")

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
# The kernel's client library warns about its own event loop and file descriptors; the code under test runs elsewhere.
@pytest.mark.filterwarnings("default")
def test_notebook_runs(path):
    notebook = nbformat.read(path, as_version=4)
    assert "assert" in notebook.cells[-1].source
    assert not any(cell.get("outputs") for cell in notebook.cells), "committed without outputs"
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
