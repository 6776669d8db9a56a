"""A flat diagram as a folder of C."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from numpy.typing import ArrayLike

from ..diagram.fixed_step import refuse_unstable_step
from ..diagram.model import FlatModel
from .casadi_source import Real
from .diagram_source import diagram_model
from .export_folder import own_order, own_symbols, write_folder
from .model import CModel

__all__ = ["export_diagram"]

_MAIN = """\
/* Runs {name} for one second at its start inputs and prints the outputs.
 *
 * Build all files of this folder:  cc -std=c99 -O2 -ffp-contract=off *.c -lm -o {name}
 * In a product, leave this file out.
 */
#include <stdio.h>

#include "{name}.h"

int main(void) {{
  static {name} self; /* static: no room on the stack */
  pf_real u[{n_u}] = {{0}}, y[{n_y}] = {{0}};
  if ({name}_init(&self)) {{
    fprintf(stderr, "{name}: damaged parameters, or flags without IEEE arithmetic: see pf_ieee.h\\n");
    return 1;
  }}
  for (int i = 0; i < {capital}_N_U; i++) u[i] = {name}_model.u(&self)[i];
  const long steps = (long)(1.0 / {capital}_STEP + 0.5);
  for (long k = 0; k <= steps; k++) {{
    const int status = {name}_step(&self, u, y);
    if (status) {{
      fprintf(stderr, "step %ld: status %d\\n", k, status);
      return 1;
    }}
    if (k % (steps / 10 + 1) == 0 || k == steps) {{
      printf("%.6f", (double)k * {capital}_STEP);
      for (int i = 0; i < {capital}_N_Y; i++) printf(" %.9g", (double)y[i]);
      printf("\\n");
    }}
  }}
  return 0;
}}
"""


def export_diagram(
    flat: FlatModel,
    folder: str | Path,
    *,
    name: str | None = None,
    real: Real = "double",
    step: float | None = None,
    substeps: int = 1,
    operating_points: Sequence[Mapping[str, ArrayLike]] = (),
    tunable: bool = True,
) -> Path:
    """Writes the C sources of a flat diagram, with an example that runs them.

    Parameters
    ----------
    flat : FlatModel
    folder : str or Path
        As :func:`write_folder`.
    name : str, optional
        C identifier, prefix of all symbols; made from the diagram's name if not given.
    real : {"double", "float"}
        Numbers of the C code.
    step : float, optional
        Seconds between two calls of ``<name>_step``; default: meets every instant of the sampled blocks.
    substeps : int
        Runge-Kutta steps in one call.
    operating_points : sequence of mapping
        States and inputs by name: where the stability of the steps is checked besides the start.
    tunable : bool
        Whether coefficients of sampled PhyFilters can be set while running; without it the code is smaller.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    FileExistsError
        If the folder holds files that no export wrote.
    FileNotFoundError
        If there is no folder for it to be in.
    ValueError
        As :func:`diagram_model`, and for a step at which the integration of a stable mode is unstable; the message says
        the longest that is stable.

    Examples
    --------
    >>> import control as ct, tempfile
    >>> from phyfilter_ctl.diagram import flatten
    >>> lag = flatten(ct.tf([1.0], [1.0, 1.0], name="lag"))
    >>> with tempfile.TemporaryDirectory() as parent:
    ...     files = export_diagram(lag, Path(parent, "lag")).iterdir()
    ...     sorted(path.name for path in files if path.suffix == ".c")
    ['lag.c', 'main.c', 'pf_run.c']
    """
    model = diagram_model(
        flat, name=name, real=real, derivatives=False, tunable=tunable, step=step, substeps=substeps
    )
    if model.states:
        refuse_unstable_step(
            flat, model.step / substeps, "give substeps={substeps}, or a step of at most {step}", substeps,
            operating_points,
        )  # fmt: skip
    return write_folder(
        folder, own_symbols(own_order(model.sources), model.name) | {"main.c": _example(model)}
    )


def _example(model: CModel) -> str:
    return _MAIN.format(
        name=model.name,
        capital=model.name.upper(),
        n_u=max(len(model.inputs), 1),
        n_y=max(len(model.outputs), 1),
    )
