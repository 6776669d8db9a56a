"""Twenty diagrams that a control engineer knows, drawn on one page to be looked at.

    python -m tests.drawing.gallery FOLDER [--screens]

Writes FOLDER/index.html and one SVG a diagram, with its faults and crossings beside it; fails where a drawing has a
fault or more crossings than it may have. ``--screens`` adds what Chromium shows of it: light.png and dark.png of the
page, notebook.png of a notebook whose cells draw the servo and, wider than the page, the drone opened.
"""

from __future__ import annotations

import argparse
import html
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import control as ct
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl import models
from tests.drawing.checker import crossings, faults
from tests.drawing.diagrams import random_diagram

PAGE = 736.0  # px: the column of text of a page


@dataclass(frozen=True)
class Case:
    """A diagram of the gallery; None crossings: any number."""

    build: Callable[[], ct.InputOutputSystem]
    crossings: int | None = None
    depth: int = 0


def _tf(
    numerator: list[float], denominator: list[float], inputs: str, outputs: str, name: str
) -> ct.TransferFunction:
    return ct.tf(numerator, denominator, inputs=inputs, outputs=outputs, name=name)


def pi() -> ct.InterconnectedSystem:
    parts = [
        _tf([2.0, 1.0], [1.0, 0.0], "e", "u", "PI"),
        _tf([1.0], [1.0, 1.0], "u", "y", "plant"),
        ct.summing_junction(["r", "-y"], "e", name="error"),
    ]
    return ct.interconnect(parts, inputs="r", outputs="y", name="pi")


def disturbed() -> ct.InterconnectedSystem:
    """PI with a disturbance in front of the plant, a sensor with noise in the feedback, and u read too."""
    parts = [
        _tf([2.0, 1.0], [1.0, 0.0], "e", "u", "PI"),
        ct.summing_junction(["u", "d"], "v", name="load"),
        _tf([1.0], [1.0, 1.0], "v", "y", "plant"),
        _tf([1.0], [0.05, 1.0], "y", "z", "sensor"),
        ct.summing_junction(["z", "n"], "ym", name="noise"),
        ct.summing_junction(["r", "-ym"], "e", name="error"),
    ]
    return ct.interconnect(parts, inputs=["r", "d", "n"], outputs=["y", "u"], name="disturbed")


def phyfilter_loop() -> ct.InterconnectedSystem:
    """x' = u_c - f_hat + f, sums by wires alone; nothing drives f_theta."""
    parts = [
        _tf([4.0], [1.0], "e", "u_c", "controller"),
        ct.summing_junction(["r", "-x"], "e", name="error"),
        _tf([1.0], [1.0, 0.0], "a", "x", "mass"),
        pf.phyfilter_block(pf.PhyFilter([400.0, 40.0]), 1, name="filter"),
    ]
    command = ["controller.u_c", "-filter.f_hat[0]"]
    return ct.interconnect(
        parts,
        connections=[
            ["controller.e", "error.e"], ["error.x", "mass.x"], ["mass.a", *command], ["filter.x[0]", "mass.x"],
            ["filter.g[0]", *command],
        ],
        inplist=["error.r", "mass.a"], inputs=["r", "f"], outlist=["mass.x"], outputs=["x"], name="phyfilter_loop",
        ignore_inputs=["filter.f_theta[0]"],
    )  # fmt: skip


def cascade() -> ct.InterconnectedSystem:
    parts = [
        _tf([10.0], [1.0], "e_theta", "omega_ref", "position"),
        _tf([5.0, 20.0], [1.0, 0.0], "e_omega", "i_ref", "speed"),
        _tf([8.0, 900.0], [1.0, 0.0], "e_i", "v", "current"),
        _tf([1.0], [0.01, 1.2], "v", "i", "winding"),
        _tf([0.3], [1.0], "i", "tau", "k_t"),
        _tf([1.0], [0.02, 0.001], "tau", "omega", "rotor"),
        _tf([1.0], [1.0, 0.0], "omega", "theta", "angle"),
        ct.summing_junction(["theta_ref", "-theta"], "e_theta", name="s1"),
        ct.summing_junction(["omega_ref", "-omega"], "e_omega", name="s2"),
        ct.summing_junction(["i_ref", "-i"], "e_i", name="s3"),
    ]
    return ct.interconnect(parts, inputs="theta_ref", outputs="theta", name="cascade")


def decoupled() -> ct.InterconnectedSystem:
    """Two loops, a matrix that decouples, four plants."""
    parts = [
        ct.summing_junction(["r1", "-y1"], "e1", name="s1"), ct.summing_junction(["r2", "-y2"], "e2", name="s2"),
        _tf([2.0, 1.0], [1.0, 0.0], "e1", "v1", "PI1"), _tf([3.0, 1.0], [1.0, 0.0], "e2", "v2", "PI2"),
        ct.ss([], [], [], [[1.0, -0.5], [-0.3, 1.0]], inputs=["v1", "v2"], outputs=["u1", "u2"], name="decoupler"),
        _tf([1.0], [1.0, 1.0], "u1", "y11", "G11"), _tf([0.5], [2.0, 1.0], "u2", "y12", "G12"),
        _tf([0.3], [3.0, 1.0], "u1", "y21", "G21"), _tf([1.0], [1.5, 1.0], "u2", "y22", "G22"),
        ct.summing_junction(["y11", "y12"], "y1", name="p1"), ct.summing_junction(["y21", "y22"], "y2", name="p2"),
    ]  # fmt: skip
    return ct.interconnect(parts, inputs=["r1", "r2"], outputs=["y1", "y2"], name="decoupled")


def vector_loop() -> ct.InterconnectedSystem:
    two = [f"[{k}]" for k in range(2)]
    plant = ct.ss(
        -np.eye(2), np.eye(2), [[1.0, 0.2], [0.1, 1.0]], np.zeros((2, 2)),
        inputs=[f"u{k}" for k in two], outputs=[f"y{k}" for k in two], name="plant",
    )  # fmt: skip
    law = ct.ss(
        np.zeros((2, 2)), np.eye(2), np.eye(2), 2 * np.eye(2), inputs=[f"e{k}" for k in two],
        outputs=[f"u{k}" for k in two], name="PI",
    )  # fmt: skip
    error = ct.summing_junction(["r", "-y"], "e", dimension=2, name="error")
    return ct.interconnect(
        [plant, law, error], inputs=[f"r{k}" for k in two], outputs=[f"y{k}" for k in two], name="vectors"
    )


def cruise() -> ct.InterconnectedSystem:
    car = ct.nlsys(
        lambda t, x, u, params: [(u[0] * u[1] - 9.8 * np.sin(u[2]) - 0.3 * x[0] ** 2) / 1600.0], None,
        inputs=["u", "gear", "theta"], outputs="v", states="v", name="vehicle",
    )  # fmt: skip
    parts = [
        car,
        _tf([0.5, 0.1], [1.0, 0.0], "e", "u", "control"),
        ct.summing_junction(["vref", "-v"], "e", name="s"),
    ]
    return ct.interconnect(parts, inputs=["vref", "gear", "theta"], outputs=["v", "u"], name="cruise")


def steering() -> ct.InterconnectedSystem:
    """Trajectory, feedback of three errors with speed scheduling, vehicle: as in python-control's examples."""
    vehicle = ct.nlsys(
        lambda t, x, u, params: [np.cos(x[2]) * u[0], np.sin(x[2]) * u[0], u[0] / 3.0 * np.tan(u[1])], None,
        inputs=["v", "phi"], outputs=["x", "y", "theta"], states=["x", "y", "theta"], name="vehicle",
    )  # fmt: skip
    law = ct.nlsys(
        None, lambda t, x, u, params: [u[3], u[4] - 0.1 * u[1] - 0.5 * u[2]],
        inputs=["ex", "ey", "etheta", "vd", "phid"], outputs=["v", "phi"], name="controller",
    )  # fmt: skip
    course = ct.nlsys(
        None, lambda t, x, u, params: [u[0] * t, u[1], 0.0, u[0], 0.0],
        inputs=["vref", "yref"], outputs=["xd", "yd", "thetad", "vd", "phid"], name="trajectory",
    )  # fmt: skip
    errors = [ct.summing_junction([f"{q}d", f"-{q}"], f"e{q}", name=f"s_{q}") for q in ("x", "y", "theta")]
    return ct.interconnect(
        [course, law, vehicle, *errors], inputs=["vref", "yref"], outputs=["x", "y", "theta"], name="steering"
    )


def saturated() -> ct.InterconnectedSystem:
    limit = ct.saturation_nonlinearity(1.0)
    nonlinear = ct.nlsys(
        None, lambda t, x, u, params: [limit(u[0])], inputs="u", outputs="v", name="saturation"
    )
    parts = [
        _tf([2.0, 1.0], [1.0, 0.0], "e", "u", "PI"), nonlinear, _tf([1.0], [1.0, 1.0, 0.0], "v", "y", "plant"),
        ct.summing_junction(["r", "-y"], "e", name="error"),
    ]  # fmt: skip
    return ct.interconnect(parts, inputs="r", outputs="y", name="saturated")


def windup() -> ct.InterconnectedSystem:
    """An integrator that is told by how much the command was cut."""
    limit = ct.nlsys(
        None, lambda t, x, u, params: [np.clip(u[0], -1, 1)], inputs="v", outputs="u", name="limit"
    )
    parts = [
        ct.summing_junction(["r", "-y"], "e", name="error"), _tf([2.0], [1.0], "e", "p", "K_p"),
        ct.summing_junction(["e", "b"], "i_in", name="i_sum"), _tf([1.0], [1.0, 0.0], "i_in", "i", "I"),
        ct.summing_junction(["p", "i"], "v", name="sum"), limit, _tf([1.0], [1.0, 1.0], "u", "y", "plant"),
        ct.summing_junction(["u", "-v"], "cut", name="difference"), _tf([4.0], [1.0], "cut", "b", "K_b"),
    ]  # fmt: skip
    return ct.interconnect(parts, inputs="r", outputs=["y", "u"], name="windup")


def observer() -> ct.InterconnectedSystem:
    A, B, C = np.array([[0.0, 1.0], [0.0, -1.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    L = np.array([[4.0], [6.0]])
    plant = ct.ss(A, B, C, 0.0, inputs="u", outputs="y", name="plant")
    estimator = ct.ss(
        A - L @ C, np.hstack([B, L]), np.eye(2), np.zeros((2, 2)), inputs=["u", "y"],
        outputs=["x_hat[0]", "x_hat[1]"], name="observer",
    )  # fmt: skip
    feedback = ct.ss([], [], [], [[-2.0, -1.0]], inputs=["x_hat[0]", "x_hat[1]"], outputs="k", name="K")
    parts = [plant, estimator, feedback, ct.summing_junction(["r", "k"], "u", name="command")]
    return ct.interconnect(parts, inputs="r", outputs="y", name="observer")


def sampled_pi() -> ct.InterconnectedSystem:
    law = ct.ss(1.0, 0.1, 1.0, 2.0, dt=0.1, inputs="e", outputs="u", name="PI")
    parts = [
        pf.sampled_block(law), _tf([1.0], [1.0, 1.0], "u", "y", "plant"),
        ct.summing_junction(["r", "-y"], "e", name="error"),
    ]  # fmt: skip
    return ct.interconnect(parts, inputs="r", outputs="y", name="sampled_pi")


def two_rates() -> ct.InterconnectedSystem:
    inner = ct.ss([], [], [], [[3.0, -3.0]], dt=0.01, inputs=["v_ref", "v"], outputs="u", name="inner")
    outer = ct.ss([], [], [], [[2.0, -2.0]], dt=0.05, inputs=["p_ref", "p"], outputs="v_ref", name="outer")
    parts = [
        pf.sampled_block(inner), pf.sampled_block(outer), _tf([1.0], [1.0, 0.2], "u", "v", "mass"),
        _tf([1.0], [1.0, 0.0], "v", "p", "integrator"),
    ]  # fmt: skip
    return ct.interconnect(parts, inputs="p_ref", outputs="p", name="two_rates")


def feedforward() -> ct.InterconnectedSystem:
    parts = [
        ct.summing_junction(["r", "-y"], "e", name="error"), _tf([2.0, 1.0], [1.0, 0.0], "e", "u_b", "PI"),
        _tf([1.0, 1.0], [0.1, 1.0], "r", "u_f", "feedforward"),
        ct.summing_junction(["u_b", "u_f"], "u", name="sum"), _tf([1.0], [1.0, 1.0], "u", "y", "plant"),
    ]  # fmt: skip
    return ct.interconnect(parts, inputs="r", outputs="y", name="feedforward")


def delayed() -> ct.InterconnectedSystem:
    """A Smith predictor."""
    parts = [
        ct.summing_junction(["r", "-y", "-c"], "e", name="error"), _tf([2.0, 1.0], [1.0, 0.0], "e", "u", "PI"),
        _tf([1.0], [1.0, 1.0], "u", "x", "plant"),
        pf.transport_delay(["x"], 0.5, outputs=["y"], name="pipe"),
        _tf([1.0], [1.0, 1.0], "u", "m", "model"),
        pf.transport_delay(["m"], 0.5, outputs=["m_late"], name="model_pipe"),
        ct.summing_junction(["m", "-m_late"], "c", name="correction"),
    ]  # fmt: skip
    return ct.interconnect(parts, inputs="r", outputs="y", name="smith")


def algebraic() -> ct.InterconnectedSystem:
    parts = [
        ct.nlsys(None, lambda t, x, u, params: np.tanh(u), inputs="e", outputs="y", name="K"),
        _tf([2.0], [1.0], "y", "z", "H"),
        ct.summing_junction(["r", "-z"], "e", name="error"),
    ]  # fmt: skip
    return ct.interconnect(parts, inputs="r", outputs="y", name="algebraic")


def nested() -> ct.InterconnectedSystem:
    motor = ct.interconnect(
        [
            ct.summing_junction(["v", "-b"], "w", name="emf"), _tf([1.0], [0.01, 1.0], "w", "i", "coil"),
            _tf([1.0], [0.1, 0.02], "i", "omega", "rotor"), _tf([0.05], [1.0], "omega", "b", "k_e"),
        ], inputs="v", outputs="omega", name="motor",
    )  # fmt: skip
    parts = [
        ct.summing_junction(["r", "-omega"], "e", name="error"), _tf([2.0, 1.0], [1.0, 0.0], "e", "v", "PI"), motor
    ]  # fmt: skip
    return ct.interconnect(parts, inputs="r", outputs="omega", name="servo")


def model(name: str) -> ct.InputOutputSystem:
    return models.load(name).build()


CASES: dict[str, Case] = {
    "pi": Case(pi, 0),
    "disturbed": Case(disturbed, 1),
    "phyfilter loop": Case(phyfilter_loop, 2),
    "cascade": Case(cascade, 0),
    "decoupled": Case(decoupled, 2),
    "vector loop": Case(vector_loop, 0),
    "cruise": Case(cruise),
    "steering": Case(steering, 8),
    "saturated": Case(saturated, 0),
    "anti-windup": Case(windup),
    "observer": Case(observer, 0),
    "sampled pi": Case(sampled_pi, 0),
    "two rates": Case(two_rates),
    "feedforward": Case(feedforward),
    "smith predictor": Case(delayed),
    "algebraic loop": Case(algebraic, 0),
    "servo, opened": Case(nested, depth=1),
    "drone": Case(partial(model, "drone")),
    "drone, opened": Case(partial(model, "drone"), depth=1),
    "arm, opened": Case(partial(model, "aerial_manipulator"), depth=1),
    "random, 40 blocks": Case(partial(random_diagram, 7, 40)),
}


def _readable(drawing: pf.Drawing) -> tuple[float, float]:
    """px of the smallest text shrunk to a page, and the width below which a page scrolls instead."""
    sizes = [float(size) for size in re.findall(r'font-size="([0-9.]+)"', drawing.svg)]
    found = re.search(r"min-width:([0-9]+)px", drawing.svg)
    return min(sizes) * min(1.0, PAGE / drawing.width), float(found[1] if found else "nan")


def notebook() -> str:
    """A notebook that draws, run and shown as JupyterLab's export shows it."""
    import nbformat
    from nbclient import NotebookClient
    from nbconvert import HTMLExporter

    cells = ["import phyfilter_ctl as pf\nfrom tests.drawing.gallery import CASES"]
    cells += [f"pf.draw(CASES[{name!r}].build(), depth=1)" for name in ("servo, opened", "drone, opened")]
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(text) for text in cells])
    NotebookClient(book, kernel_name="python3").execute()
    shown, _ = HTMLExporter().from_notebook_node(book)
    return shown


def photographed(folder: Path) -> None:
    from playwright.sync_api import sync_playwright

    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=found, args=["--no-sandbox"])
        for name, page, scheme in (
            ("light", "index", "light"), ("dark", "index", "dark"), ("notebook", "notebook", "light")
        ):  # fmt: skip
            shot = browser.new_page(color_scheme=scheme, viewport={"width": 1000, "height": 700})
            shot.goto((folder / f"{page}.html").resolve().as_uri(), wait_until="domcontentloaded")
            shot.screenshot(path=folder / f"{name}.png", full_page=True)
            shot.close()
        browser.close()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--screens", action="store_true", help="needs playwright, nbconvert and Chromium")
    options = parser.parse_args()
    folder: Path = options.folder
    folder.mkdir(parents=True, exist_ok=True)
    rows, bad = [], 0
    for name, case in CASES.items():
        system = case.build()
        drawing = pf.draw(system, depth=case.depth)
        maps = system if case.depth == 0 and isinstance(system, ct.InterconnectedSystem) else None
        found, crossed = faults(drawing, maps), crossings(drawing)
        bad += bool(found) or (case.crossings is not None and crossed > case.crossings)
        (folder / f"{name.replace(', ', '_').replace(' ', '_')}.svg").write_text(
            drawing.svg, encoding="utf-8"
        )
        told = "".join(f"<li>{html.escape(f'{fault.kind}: {fault.what}')}</li>" for fault in found)
        limit = "" if case.crossings is None else f" (at most {case.crossings})"
        rows.append(f"<h2>{name}</h2><p>{crossed} crossings{limit}</p><ul>{told}</ul>{drawing.svg}")
        size, least = _readable(drawing)
        print(
            f"{name:20} {len(found):3} faults, {crossed:3} crossings{limit:13}  {drawing.width:5.0f} px wide, "
            f"at {PAGE:.0f} px of a page its smallest text has {size:4.1f} px; scrolls below {least:4.0f} px"
        )
    head = "<!doctype html><meta charset=utf-8><title>Block diagrams</title>"
    head += "<style>:root{color-scheme:light dark}</style>"
    (folder / "index.html").write_text(head + "\n".join(rows), encoding="utf-8")
    if options.screens:
        (folder / "notebook.html").write_text(notebook(), encoding="utf-8")
        photographed(folder)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
