"""Recipes of FMUs: a folder says what to export and keeps recorded results to hold the FMU against.

``recipe.toml``::

    format = "phyfilter-fmu"
    version = 1
    filter = "filter.toml"      # a filter file beside it; or
    # system = "package.module:function"   a function without arguments that returns a python-control system

    [export]
    fmi = ["2.0", "3.0"]        # FMI versions to build and check
    channels = 3                # filter: number of channels
    rate = "communication"      # sampled filter: or "fixed"

    [reference]
    step = 0.002                # communication step, seconds
    stop = 0.5                  # end of the record
    inputs_at = "end"           # inputs of a step are those at its "start" or its "end"
    rtol = 0.0
    atol = 1e-13

Beside it ``NAME_in.csv`` and ``NAME_out.csv``, NAME being the folder's. What is recorded comes from the library's own
simulation of the system, not from an FMU.
"""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .._sections import FloatArray
from ..blocks import phyfilter_block
from ..filter import FilterBank, PhyFilter, SampledPhyFilter, Sampling
from ..filter.sampling import ChannelOptions
from ..filterfile.document import read_noted
from ..filterfile.table import TomlTable, parsed
from ..simulation import simulate
from .check import CheckReport, check
from .export import export_fmu
from .ports import FmuPorts
from .replay import Reference, read_table

__all__ = ["Recipe", "check_all", "check_recipe", "read_recipe", "rebuild", "record"]

Fmi = Literal["2.0", "3.0"]
FORMAT, VERSION = "phyfilter-fmu", 1
_KEYS = ("format", "version", "filter", "system", "export", "reference")
_EXPORT_KEYS = ("fmi", "channels", "rate")
_REFERENCE_KEYS = ("step", "stop", "inputs_at", "rtol", "atol")
_VERSIONS = ("2.0", "3.0")
Exportable = PhyFilter | FilterBank | SampledPhyFilter | ct.InputOutputSystem


@dataclass(frozen=True, eq=False)
class Recipe:
    """A recipe, read.

    Parameters
    ----------
    name : str
        The folder's.
    folder : Path
    system : PhyFilter, SampledPhyFilter or control.InputOutputSystem
    noted : ChannelOptions
        Names, units and inertia that a continuous filter's file notes.
    fmi : tuple of {"2.0", "3.0"}
    channels : int or None
    rate : {"communication", "fixed"}
    step, stop : float
        Seconds.
    inputs_at : {"start", "end"}
    rtol, atol : float
        Allowed deviation from the record.
    """

    name: str
    folder: Path
    system: Exportable
    noted: ChannelOptions
    fmi: tuple[Fmi, ...]
    channels: int | None
    rate: Literal["communication", "fixed"]
    step: float
    stop: float
    inputs_at: Literal["start", "end"]
    rtol: float
    atol: float

    @property
    def reference(self) -> Path:
        """Recorded outputs."""
        return self.folder / f"{self.name}_out.csv"


def read_recipe(folder: str | Path) -> Recipe:
    """Read ``recipe.toml``.

    Parameters
    ----------
    folder : str or Path

    Raises
    ------
    FileNotFoundError
        If the folder has none.
    ValueError
        If a key is missing, unknown or wrong; if the system cannot be made.
    """
    folder = Path(folder)
    file = folder / "recipe.toml"
    top = TomlTable(file, "", parsed(file))
    if top.text("format") != FORMAT or top.integer("version") != VERSION:
        raise top.error(
            "format", f"expected {FORMAT!r} of version {VERSION}: not a recipe this library reads"
        )
    top.refuse_unknown(_KEYS)
    export, reference = top.table("export"), top.table("reference")
    export.refuse_unknown(_EXPORT_KEYS)
    reference.refuse_unknown(_REFERENCE_KEYS)
    system, noted = _system(top, folder)
    step, stop = reference.number("step"), reference.number("stop")
    if not 0.0 < step <= stop:
        raise reference.error("step", f"expected 0 < step <= stop, got {step:g} and {stop:g}")
    return Recipe(
        name=folder.resolve().name,
        folder=folder,
        system=system,
        noted=noted,
        fmi=cast(
            tuple[Fmi, ...], tuple(_choice(export, text, _VERSIONS, "fmi") for text in export.texts("fmi"))
        ),
        channels=export.integer("channels") if "channels" in export else None,
        rate=cast(
            Literal["communication", "fixed"],
            _choice(
                export,
                export.text("rate") if "rate" in export else "communication",
                ("communication", "fixed"),
                "rate",
            ),
        ),
        step=step,
        stop=stop,
        inputs_at=cast(
            Literal["start", "end"],
            _choice(reference, reference.text("inputs_at"), ("start", "end"), "inputs_at"),
        ),
        rtol=reference.number("rtol"),
        atol=reference.number("atol"),
    )


def rebuild(
    folder: str | Path,
    path: str | Path | None = None,
    *,
    fmi: Fmi | None = None,
    platforms: Sequence[str] | Literal["all"] = ("native",),
) -> Path:
    """Export the FMU of a recipe.

    Parameters
    ----------
    folder : str or Path
    path : str or Path, optional
        File to write; ``NAME.fmu`` in the recipe's folder by default.
    fmi : {"2.0", "3.0"}, optional
        The first version of the recipe by default.
    platforms : sequence of str or "all"
        As for ``export_fmu``.

    Returns
    -------
    Path

    Raises
    ------
    ValueError, FileNotFoundError
        As for :func:`read_recipe` and ``export_fmu``.
    """
    return _exported(read_recipe(folder), path, fmi, platforms)


def record(folder: str | Path) -> Path:
    """Write the record of a recipe from the library's own simulation.

    ``NAME_in.csv`` is used as it is where it exists, so a recipe can bring inputs that suit its system; else smooth
    test signals are written.

    Parameters
    ----------
    folder : str or Path

    Returns
    -------
    Path
        ``NAME_out.csv``.
    """
    recipe = read_recipe(folder)
    count = round(recipe.stop / recipe.step)
    times: FloatArray = recipe.step * np.arange(count + 1, dtype=np.float64)
    labels, run = _runner(recipe)
    given = recipe.folder / f"{recipe.name}_in.csv"
    if given.exists():
        inputs = np.column_stack([read_inputs(given, label, times) for label in labels])
    else:
        inputs = _test_signals(len(labels), times)
    names, outputs = run(times, inputs)
    columns = (
        dict(zip(each, values.T, strict=True)) for each, values in ((labels, inputs), (names, outputs))
    )
    Reference(times, *columns).write(recipe.reference)
    return recipe.reference


def check_recipe(folder: str | Path) -> tuple[CheckReport, ...]:
    """Build the FMU of a recipe in a temporary folder and check it against the record; one report per FMI version.

    Parameters
    ----------
    folder : str or Path

    Raises
    ------
    FileNotFoundError
        If nothing is recorded yet.
    """
    recipe = read_recipe(folder)
    if not recipe.reference.exists():
        raise FileNotFoundError(f"{recipe.reference}: nothing is recorded; record({str(folder)!r}) writes it")
    reports = []
    with tempfile.TemporaryDirectory(prefix="phyfilter-") as scratch:
        for version in recipe.fmi:
            path = _exported(
                recipe, Path(scratch, f"{recipe.name}_fmi{version[0]}.fmu"), version, ("native",)
            )
            reports.append(
                check(
                    path,
                    reference=recipe.reference,
                    inputs_at=recipe.inputs_at,
                    rtol=recipe.rtol,
                    atol=recipe.atol,
                )
            )
    return tuple(reports)


def check_all(root: str | Path) -> dict[str, tuple[CheckReport, ...]]:
    """Check every recipe in a folder of recipes.

    Parameters
    ----------
    root : str or Path

    Raises
    ------
    ValueError
        If there is none.
    """
    folders = sorted(file.parent for file in Path(root).glob("*/recipe.toml"))
    if not folders:
        raise ValueError(f"{root}: no recipes; expected folders with a recipe.toml")
    return {folder.name: check_recipe(folder) for folder in folders}


def read_inputs(path: Path, label: str, times: FloatArray) -> FloatArray:
    """One recorded input at other times, linear in between.

    Parameters
    ----------
    path : Path
        ``NAME_in.csv``.
    label : str
    times : (N,) array
    """
    names, table = read_table(path)
    if label not in names:
        raise ValueError(f"{path}: no column {label!r}; there are {', '.join(names)}")
    return np.interp(times, table[:, 0], table[:, names.index(label)])


def _choice(table: TomlTable, text: str, allowed: tuple[str, ...], key: str) -> str:
    if text not in allowed:
        raise table.error(key, f"expected one of {', '.join(allowed)}, got {text!r}")
    return text


def _system(top: TomlTable, folder: Path) -> tuple[Exportable, ChannelOptions]:
    if ("filter" in top) == ("system" in top):
        raise top.error("filter", 'expected either filter = "file.toml" or system = "module:function"')
    if "filter" in top:
        file = folder / top.text("filter")
        return read_noted(file)
    module, _, name = top.text("system").partition(":")
    try:
        system = getattr(importlib.import_module(module), name)()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise top.error("system", f"expected module:function, got {top.text('system')!r}: {error}") from error
    if not isinstance(system, ct.InputOutputSystem):
        raise top.error(
            "system", f"expected a function that returns a python-control system, got {type(system)}"
        )
    return system, {}


def _exported(
    recipe: Recipe, path: str | Path | None, fmi: Fmi | None, platforms: Sequence[str] | Literal["all"]
) -> Path:
    target = Path(path) if path is not None else recipe.folder / f"{recipe.name}.fmu"
    version = fmi or recipe.fmi[0]
    if isinstance(recipe.system, ct.InputOutputSystem) and not isinstance(recipe.system, PhyFilter):
        return export_fmu(recipe.system, target, fmi=version, name=recipe.name, platforms=platforms)
    return export_fmu(
        recipe.system,
        target,
        fmi=version,
        name=recipe.name,
        platforms=platforms,
        rate=recipe.rate,
        ports=FmuPorts(
            channels=recipe.channels or recipe.noted.get("channels"),
            inertia=recipe.noted.get("inertia"),
            units=recipe.noted.get("units"),
        ),
    )


Runner = Callable[[FloatArray, FloatArray], tuple[list[str], FloatArray]]


def _runner(recipe: Recipe) -> tuple[list[str], Runner]:
    """Names of the inputs, and what runs the system on them without any FMU."""
    if isinstance(recipe.system, ct.InputOutputSystem) and not isinstance(recipe.system, PhyFilter):
        return _diagram_runner(recipe.system)
    known = Sampling(1.0, **recipe.noted)
    if isinstance(recipe.system, SampledPhyFilter):
        known = recipe.system.sampling
    n_x = recipe.channels or known.n_x or 1
    if isinstance(recipe.system, SampledPhyFilter):
        return _sampled_runner(recipe.system, n_x)
    return _continuous_runner(recipe.system, n_x, recipe)


def _names(n_x: int, n_f: int) -> list[str]:
    counts = {"x": n_x, "g": n_x, "f_theta": n_f}
    return [f"{signal}[{i}]" for signal, count in counts.items() for i in range(count)]


def _sampled_runner(sampled: SampledPhyFilter, n_x: int) -> tuple[list[str], Runner]:
    n_f = n_x if sampled.E is None else sampled.E.shape[1]

    def run(times: FloatArray, u: FloatArray) -> tuple[list[str], FloatArray]:
        x, g, f_theta = np.split(u, [n_x, 2 * n_x], axis=1)
        f_hat = sampled.run(x, g, f_theta, times=times)
        return [f"f_hat[{i}]" for i in range(n_f)], np.asarray(f_hat, dtype=np.float64)

    return _names(n_x, n_f), run


def _continuous_runner(filter: PhyFilter | FilterBank, n_x: int, recipe: Recipe) -> tuple[list[str], Runner]:
    block = phyfilter_block(filter, n_x, inertia=cast(ArrayLike | None, recipe.noted.get("inertia")))

    def run(times: FloatArray, u: FloatArray) -> tuple[list[str], FloatArray]:
        """Exact on inputs held over each step, from the state at rest for the first x."""
        held = ct.c2d(ct.ss(block.A, block.B, block.C, block.D), recipe.step, "zoh")
        z = block.rest_state(u[0, :n_x])
        rows = []
        for now in u:
            rows.append(held.C @ z + held.D @ now)
            z = held.A @ z + held.B @ now
        return list(block.output_labels), np.array(rows)

    return list(block.input_labels), run


def _diagram_runner(system: ct.InputOutputSystem) -> tuple[list[str], Runner]:
    def run(times: FloatArray, u: FloatArray) -> tuple[list[str], FloatArray]:
        # The virtual machine everywhere: "auto" may take C where there is a compiler, with other last digits.
        response = simulate(system, times, u.T, interpolation="hold", backend="vm", rtol=1e-11, atol=1e-13)
        if not response.success:
            raise RuntimeError(f"{system.name}: {response.message}")
        return list(system.output_labels), np.asarray(response.outputs).reshape(
            len(system.output_labels), -1
        ).T

    return list(system.input_labels), run


def _test_signals(count: int, times: FloatArray) -> FloatArray:
    """Smooth signals of order one, all different: two tones each."""
    k = np.arange(count)
    return np.sin(np.outer(times, 3.0 + 0.7 * k) + k) + 0.2 * np.cos(np.outer(times, 17.0 + 1.3 * k))
