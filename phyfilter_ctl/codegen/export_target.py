"""Exports as a package that the build of a target takes as it is."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator, Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Literal, get_args

import control as ct
from numpy.typing import ArrayLike

from .._renamed import takes_signals
from ..diagram import FlatModel
from ..filter import SampledPhyFilter
from .export import export_c
from .export_folder import write_folder
from .filter_code import which_g
from .filter_guard import guard_costs, guard_sources, guard_stack
from .target_autopilots import autopilot_values, check_autopilot

__all__ = ["Target", "export_target"]

Target = Literal["arduino", "ardupilot", "cmake", "crazyflie", "px4", "ros2", "rust", "zephyr"]

_AUTOPILOTS = ("ardupilot", "crazyflie", "px4", "ros2")
_PLACES = {"ardupilot": "libraries/AC_CustomControl/{}", "px4": "src/modules/{}"}  # else src
_VERSION = "0.1.0"  # of the package that is written; its user counts on from here
_OF_FILTER = """\
Every @dt@ s, with time stamps in microseconds:

```c
static @name@_guard guard;
if (@name@_guard_init(&guard, &@name@_parameters)) return;  /* pf_filter_message says why */
uint32_t health = @name@_guard_step(&guard, time_us, x, g, f_theta, NULL, f_hat);
```

g is @which_g@. `health` says what was wrong with what came in: `pf_guard.h`. f_hat is finite and within its limit
after every step. `@name@_guard_send` takes other poles from another thread, `@name@_guard_check` finds flipped bits. No
call takes more than @stack@ bytes of stack on a Cortex-M (gcc -Os, -O2, -O3).
"""
_OF_INTEGERS = """\
Every @dt@ s, on integers (`@name@_X_FRACTION` and so on are their fractional bits):

```c
static @name@ filter;
if (@name@_init(&filter, &@name@_parameters)) return;
int flags = @name@_step(&filter, x, g, f_theta, f_hat);  /* what saturated: see src/pf_q31.h */
```

g is @which_g@.
"""
_OF_DIAGRAM = """\
Every `@NAME@_STEP` s:

```c
static @name@ self;
if (@name@_init(&self)) return;
int status = @name@_step(&self, u, y);  /* not 0: the state is as before, see src/pf_model.h */
```
"""
_PLACE = re.compile(r"@(\w+)@")


@takes_signals
def export_target(
    system: ct.InputOutputSystem | FlatModel | SampledPhyFilter,
    target: Target,
    folder: str | Path,
    *,
    real: Literal["double", "float", "q31"] | None = None,
    ranges: Mapping[str, float] | None = None,
    name: str | None = None,
    channels: int | None = None,
    inertia: ArrayLike | Literal["scalar", "diagonal", "full"] | None = None,
) -> Path:
    """Write a sampled filter or a diagram as a package for a target's own build.

    Parameters
    ----------
    system : control.InputOutputSystem, FlatModel or SampledPhyFilter
    target : {"arduino", "ardupilot", "cmake", "crazyflie", "px4", "ros2", "rust", "zephyr"}
        Arduino library (PlatformIO takes it too), CMake project with package files, Zephyr module; crate for Rust
        without std (a filter); app of the Crazyflie, external module of PX4, backend of ArduPilot's custom controller
        and component of ROS 2 (one low-pass filter that three channels share, without inertia; the first two on the
        velocity per unit of mass, the third on the body rates, in float).
    folder : str or Path
        Written whole or not at all; files that no export wrote are not touched.
    real, ranges, name, channels, inertia
        As :func:`export_c`. "q31" is for cmake and arduino, without the guard.

    Returns
    -------
    Path
        The folder: sources in ``src``, a filter with its guard against faulty signals, a test against recorded
        numbers in ``test``, README and licence. PX4 and ArduPilot have their own places for sources.

    Raises
    ------
    TypeError
        If the system is of another kind; a continuous filter needs ``sampled(dt)``.
    ValueError
        If the target is unknown, or as :func:`export_c`.
    FileExistsError
        If the folder holds files that no export wrote.

    Examples
    --------
    >>> import tempfile
    >>> from phyfilter_ctl import PhyFilter
    >>> filter_ = PhyFilter([20.0]).sampled(0.002)
    >>> with tempfile.TemporaryDirectory() as parent:
    ...     made = export_target(filter_, "cmake", Path(parent, "wing"), channels=3, name="wing")
    ...     sorted(path.name for path in made.iterdir())
    ['CMakeLists.txt', 'LICENSE', 'README.md', 'pf_files.txt', 'src', 'test', 'wing.pc.in']
    """
    if target not in get_args(Target):
        raise ValueError(f"target: expected one of {', '.join(get_args(Target))}, got {target!r}")
    if real == "q31" and target not in ("arduino", "cmake"):
        raise ValueError(f"{target}: expected real='double' or 'float'; q31 is for arduino and cmake")
    if target in _AUTOPILOTS:
        if isinstance(system, SampledPhyFilter):
            channels = system.sampling.channels_or(channels)
            inertia = system.sampling.inertia if inertia is None else inertia
        check_autopilot(target, system, name or "phyfilter", channels, inertia)
        real, channels = real or ("double" if target == "ros2" else "float"), 3
    if target == "rust" and not isinstance(system, SampledPhyFilter):
        raise ValueError(
            "rust: expected a sampled filter; a diagram goes into a crate of its own by export_c"
        )
    with tempfile.TemporaryDirectory() as parent:
        written = export_c(
            system,
            Path(parent, "code"),
            real=real, ranges=ranges, name=name, channels=channels, inertia=inertia,
        )  # fmt: skip
        sources = {path.name: path.read_text(encoding="utf-8") for path in written.glob("*.[ch]")}
    tests = {
        file: sources.pop(file) for file in sorted(sources) if file == "main.c" or file.endswith("_vectors.h")
    }
    # The model's own header has the shortest name beside those of the runtime.
    model = min((file[:-2] for file in sources if not file.startswith("pf_")), key=len)
    kind = "q31" if real == "q31" else "filter" if isinstance(system, SampledPhyFilter) else "diagram"
    own: dict[str, str] = {}
    if kind == "filter":
        sizes = _sizes(sources[f"{model}.h"], model)
        stack = guard_stack(
            sizes["ORDER"], filters=sizes["FILTERS"], channels=sizes["N_X"], inertia=sizes["N_M"]
        )
        shared = sizes["FILTERS"] == 1 and sizes["N_X"] == sizes["N_F"] == 3 and not sizes["N_M"]
        costs = guard_costs(sizes["ORDER"], "float" if sizes["FLOAT"] else "double") if shared else None
        sources |= guard_sources(model, stack, costs)
        own = {key.lower(): str(sizes[key]) for key in ("N_X", "N_F", "N_M")}
        own |= {"stack": f"{stack:,}", "rust_real": "f32" if sizes["FLOAT"] else "f64"}
    values = _values(system, model, sorted(file for file in sources if file.endswith(".c")), own)
    if kind == "q31":
        values |= {"header": f"{model}.h", "usage": _filled(_OF_INTEGERS, values)}
    place = _PLACES.get(target, "src").format(model)
    files = {f"{place}/{file}": text for file, text in sources.items()}
    files |= {f"test/{file}": text for file, text in tests.items()}
    templates = resources.files("phyfilter_ctl.codegen") / "targets"
    for part in ("common", kind):
        files |= {
            _filled(path, values): _filled(text, values) for path, text in _texts(templates / target / part)
        }
    files["LICENSE"] = (templates / "LICENSE").read_text(encoding="utf-8")
    return write_folder(folder, files)


def _values(
    system: ct.InputOutputSystem | FlatModel | SampledPhyFilter,
    name: str,
    c_files: list[str],
    own: dict[str, str],
) -> dict[str, str]:
    """What the templates leave open."""
    values = own | {
        "name": name,
        "NAME": name.upper(),
        "version": _VERSION,
        "sources": "\n".join(f"  src/{file}" for file in c_files),
        "module_sources": "\n".join(f"    ${{CMAKE_CURRENT_LIST_DIR}}/../src/{file}" for file in c_files),
    }
    if isinstance(system, SampledPhyFilter):
        values |= {
            "header": f"{name}_guard.h",
            "description": "a sampled PhyFilter that estimates the unknown part of M x' = g + f",
            "xml_description": "a sampled PhyFilter that estimates the unknown part of M x&apos; = g + f",
            "dt": f"{system.dt:g}",
            "which_g": which_g(system),
            "rust_dt": repr(float(system.dt)),
            "rust_files": ", ".join(f'"{file}"' for file in [*c_files, f"{name}_rust.c"]),
            "period_us": str(round(1e6 * system.dt)),
        }
        return values | autopilot_values(system, name, c_files) | {"usage": _filled(_OF_FILTER, values)}
    values |= {"header": f"{name}.h", "description": "a block diagram, one step at a time"}
    return values | {"usage": _filled(_OF_DIAGRAM, values)}


def _sizes(header: str, name: str) -> dict[str, int]:
    """Options of a filter's header, and N_M, the entries of an inertia that is given at every step."""
    options = {key: int(value) for key, value in re.findall(rf"#define {name}_(\w+) (\d+)", header)}
    n_x = options["N_X"]
    entries = (0, 1, n_x, n_x * n_x)[options["INERTIA"]] if options["INERTIA_INPUT"] else 0
    return options | {"N_M": entries}


def _texts(folder: Traversable, above: str = "") -> Iterator[tuple[str, str]]:
    """Relative path and text of all files in a folder, none where there is no folder."""
    if not folder.is_dir():
        return
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            yield from _texts(entry, f"{above}{entry.name}/")
        else:
            yield f"{above}{entry.name}", entry.read_text(encoding="utf-8")


def _filled(text: str, values: Mapping[str, str]) -> str:
    """Text with the values for @name@ and the like; other such words are the target's own."""
    return _PLACE.sub(lambda found: values.get(found[1], found[0]), text)
