"""FMUs of MuJoCo models, with MuJoCo inside."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .._renamed import takes_former
from ..blocks.functions import Variable
from ..codegen.compiler import CompilerError
from ..codegen.identifiers import checked_identifier, identifier
from ..codegen.model import CModel
from ..plants.legged.simulator import simulator
from .archive_write import write_archive
from .build import build_binaries, native_platform
from .description import Fmi, FmuExperiment, fmu_interface
from .documentation import documentation_page
from .export import fmu_entries, sealed

__all__ = ["export_mujoco_fmu"]

# The first with structured messages, by which its errors are caught.
_OLDEST = (4, 0)
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_NUMBERS_A_LINE = 24

# Units of sensors by type; of those that are missing none is known.
_SENSORS = {
    "m": "JOINTLIMITPOS TENDONPOS TENDONLIMITPOS FRAMEPOS SUBTREECOM RANGEFINDER GEOMDIST GEOMFROMTO",
    "m/s": "VELOCIMETER TENDONVEL TENDONLIMITVEL FRAMELINVEL SUBTREELINVEL",
    "m/s^2": "ACCELEROMETER FRAMELINACC",
    "rad/s": "GYRO BALLANGVEL FRAMEANGVEL",
    "rad/s^2": "FRAMEANGACC",
    "N": "TOUCH FORCE TENDONACTFRC TENDONLIMITFRC",
    "N m": "TORQUE",
    "kg m^2/s": "SUBTREEANGMOM",
    "J": "E_POTENTIAL E_KINETIC",
    "s": "CLOCK",
    "1": "BALLQUAT FRAMEQUAT FRAMEXAXIS FRAMEYAXIS FRAMEZAXIS GEOMNORMAL INSIDESITE",
}
_SENSOR_UNITS = {name: unit for unit, names in _SENSORS.items() for name in names.split()}
# Of those on one joint, on a hinge and on a slide.
_JOINT_SENSORS = {
    "JOINTPOS": ("rad", "m"),
    "JOINTVEL": ("rad/s", "m/s"),
    "JOINTLIMITPOS": ("rad", "m"),
    "JOINTLIMITVEL": ("rad/s", "m/s"),
    "JOINTLIMITFRC": ("N m", "N"),
    "JOINTACTFRC": ("N m", "N"),
}

_NOTE = """\
Physics: MuJoCo {version}, in {library} beside the binary, which finds it there; licences: documentation/licenses.
The model is documentation/model.xml and is compiled when the first instance starts.
A communication step makes whole timesteps of {timestep:g} s; one that is no multiple of it is discarded.
Sensors are those of the last timestep, as MuJoCo evaluates them: at its beginning.
Where MuJoCo would go back to the start (numbers not finite or beyond 1e10) or leave contacts out for want of memory,
the step is discarded.
There are no sources inside: they cannot be built without MuJoCo's headers and library."""


@takes_former
def export_mujoco_fmu(
    xml: str,
    path: str | Path,
    *,
    fmi: Fmi = "3.0",
    name: str | None = None,
    body: str = "",
    start: ArrayLike | None = None,
    experiment: FmuExperiment | None = None,
    compiler: str | Path | Sequence[str] | None = None,
) -> Path:
    """Write a MuJoCo model as a co-simulation FMU that needs nothing but itself to run, on this machine's platform.

    Parameters
    ----------
    xml : str
        MJCF that refers to no files.
    path : str or Path
        The file; replaced if it exists, and only once the FMU is complete.
    fmi : {"3.0", "2.0"}
    name : str, optional
        Model identifier, a C identifier. By default the model's name.
    body : str
        A body with an input ``force[0..2]``: force on its centre of mass, in the world's axes, N. "": no such input.
    start : (nq,) array, optional
        Positions at the start, as ``qpos``; None: those of the model.
    experiment : FmuExperiment, optional
        What importers take by default, author and description; None: steps of one timestep.
    compiler : str, Path or sequence of str, optional
        By default $CC, cc, gcc, clang or ziglang's.

    Returns
    -------
    Path
        ``path``.

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    ValueError
        For a model that MuJoCo refuses, that refers to files, or whose state MuJoCo cannot give and take back whole
        (plugins, flexible bodies, sleeping); for a body that it does not have, or a start of the wrong length.
    CompilerError
        On another system than Linux, or where the compiler is missing or fails.

    Notes
    -----
    Inputs are ``ctrl.<actuator>``. Outputs are ``qpos.<joint>``, ``qvel.<joint>`` and ``sensor.<sensor>``; a free
    joint has ``.position``, ``.quaternion`` (w, x, y, z), ``.velocity`` and ``.rate``. Parameters ``start.<joint>`` are
    positions at the start. What has no name, or none that FMI allows, is numbered: ``ctrl.actuator0``.

    The state of an instance is MuJoCo's own (``mjSTATE_INTEGRATION``): it can be taken, put back and written as bytes,
    and a run is that of MuJoCo to the bit.

    References
    ----------
    .. [2] Todorov, Erez and Tassa, "MuJoCo: a physics engine for model-based control", IROS 2012.

    Examples
    --------
    >>> import tempfile
    >>> ball = '<mujoco model="ball"><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
    >>> with tempfile.TemporaryDirectory() as folder:  # doctest: +SKIP
    ...     export_mujoco_fmu(ball, Path(folder, "ball.fmu")).name
    'ball.fmu'
    """
    mujoco = _mujoco()
    compiled = _compiled(mujoco, xml)
    index = _body(mujoco, compiled, body)
    positions = _start(compiled, start)
    facts = _Facts(mujoco, compiled, positions)
    platform = native_platform()
    if not platform.name.endswith("linux"):
        raise CompilerError(f"an FMU with MuJoCo inside is made on Linux; this is {platform.name}")
    chosen = _name(xml) if name is None else checked_identifier(name)
    library = _library(mujoco)
    header = _header(facts, chosen, xml, index)
    model = _model(facts, chosen, header, pushed=bool(index))
    interface = fmu_interface(
        model,
        fmi=fmi,
        kinds=("cs",),
        experiment=experiment or FmuExperiment(step=model.communication),
        derivatives=False,
        tunable=False,
        fixed_step=model.communication,
        why="pf_mujoco_why",
    )
    token, sources = sealed(interface)
    flags = _linked(library)
    binaries = build_binaries(
        sources, name=chosen, fmi=fmi, platforms=("native",), compiler=compiler, flags=flags
    )
    note = _NOTE.format(version=mujoco.__version__, library=library.name, timestep=compiled.opt.timestep)
    page = documentation_page(interface, notes=[note])
    entries = fmu_entries(interface, token, {}, page)
    entries["documentation/model.xml"] = xml
    entries |= _licences(mujoco.__version__)
    entries |= binaries
    entries[f"binaries/{platform.folder(fmi)}/{library.name}"] = library.read_bytes()
    return write_archive(path, entries)


def _mujoco() -> Any:  # untyped where the extra is not installed
    mujoco = simulator("an FMU with MuJoCo inside")
    version = tuple(int(part) for part in re.findall(r"\d+", mujoco.__version__)[:2])
    if version < _OLDEST:
        raise ImportError(f"expected MuJoCo {_OLDEST[0]}.{_OLDEST[1]} or later, got {mujoco.__version__}")
    return mujoco


def _compiled(mujoco: Any, xml: str) -> Any:
    try:
        root = ET.fromstring(xml)
    except ET.ParseError as error:
        raise ValueError(f"xml: expected MJCF: {error}") from None
    for element in root.iter():
        files = [value for key, value in element.attrib.items() if key.startswith("file")]
        if files:
            raise ValueError(
                f"xml: <{element.tag}> refers to the file {files[0]!r}; expected MJCF without files"
            )
    try:
        compiled = mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        raise ValueError(f"xml: {error}") from None
    sleeping = compiled.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP
    for what, there in (
        ("plugins", compiled.nplugin),
        ("flexible bodies", compiled.nflex),
        ("sleep", sleeping),
    ):
        if there:
            raise ValueError(
                f"xml: {what}: expected a model without, whose state can be taken and put back whole"
            )
    if not compiled.nq:
        raise ValueError("xml: expected a model with joints, got one in which nothing moves")
    return compiled


def _body(mujoco: Any, compiled: Any, body: str) -> int:
    if not body:
        return 0
    index = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_BODY, body)
    if index < 1:
        there = [compiled.body(i).name for i in range(1, compiled.nbody) if compiled.body(i).name]
        raise ValueError(
            f"body: expected one of {', '.join(there) or 'none, no body has a name'}; got {body!r}"
        )
    return int(index)


def _start(compiled: Any, start: ArrayLike | None) -> NDArray[np.float64]:
    return _signals.array("start", compiled.qpos0 if start is None else start, (compiled.nq,))


def _name(xml: str) -> str:
    plain = identifier(ET.fromstring(xml).get("model") or "model").strip("_")
    return checked_identifier(plain if plain[:1].isalpha() else f"model_{plain}")


def _library(mujoco: Any) -> Path:
    found = sorted(Path(mujoco.__file__).parent.glob("libmujoco.so.*"))
    if len(found) != 1:
        raise FileNotFoundError(
            f"{Path(mujoco.__file__).parent}: expected one libmujoco.so.*, found {len(found)}; install MuJoCo from "
            "its wheel"
        )
    return found[0]


def _linked(library: Path) -> tuple[str, ...]:
    """What the compiler needs to find MuJoCo now, and the loader to find it beside the FMU's binary."""
    return (
        f"-I{library.parent / 'include'}",
        "-pthread",
        # Before the objects: kept all the same, whatever the linker's habit.
        "-Wl,--no-as-needed",
        str(library),
        "-Wl,-rpath,$ORIGIN",
    )


class _Facts:
    """Sizes, names and units of a compiled model."""

    def __init__(self, mujoco: Any, compiled: Any, start: NDArray[np.float64]) -> None:
        self.mujoco, self.compiled, self.start = mujoco, compiled, start
        self.inputs = tuple(self._controls())
        joints = [self._joint(k) for k in range(compiled.njnt)]
        self.positions = tuple(v for group in joints for v in group[0])
        self.velocities = tuple(v for group in joints for v in group[1])
        self.sensors = tuple(v for k in range(compiled.nsensor) for v in self._sensor(k))
        self.parameters = tuple(
            Variable(
                f"start{v.name.removeprefix('qpos')}", float(value), v.unit, f"At the start: {v.description}"
            )
            for v, value in zip(self.positions, start, strict=True)
        )

    @property
    def state(self) -> int:
        """Length of the state."""
        return int(self.mujoco.mj_stateSize(self.compiled, self.mujoco.mjtState.mjSTATE_INTEGRATION))

    def _controls(self) -> Iterator[Variable]:
        compiled = self.compiled
        for k in range(compiled.nactuator):
            actuator = compiled.actuator(k)
            count = int(compiled.actuator_ctrlnum[k])
            base = f"ctrl.{_label(actuator.name, 'actuator', k)}"
            text = f"Control of actuator {actuator.name or k}"
            # A control that rests outside its range is left open: a start is 0 here.
            ends = np.ravel(actuator.ctrlrange).tolist()
            ranged = count == 1 and np.all(actuator.ctrllimited) and ends[0] <= 0.0 <= ends[1]
            low, high = ends if ranged else (-np.inf, np.inf)
            for i in range(count):
                label = base if count == 1 else f"{base}[{i}]"
                yield Variable(label, 0.0, self._control_unit(k), text, low, high)

    def _control_unit(self, k: int) -> str:
        """Of torque and force motors and of servos on joints; "" where it depends on more."""
        mujoco, compiled = self.mujoco, self.compiled
        joints = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
        gain_type, bias_type = int(compiled.actuator_gaintype[k]), int(compiled.actuator_biastype[k])
        if int(compiled.actuator_trntype[k]) not in map(int, joints) or gain_type != int(
            mujoco.mjtGain.mjGAIN_FIXED
        ):
            return ""
        kind = self._kind(compiled.actuator_trnid[k, 0])
        if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            return ""
        units = ("N m", "rad", "rad/s") if kind == mujoco.mjtJoint.mjJNT_HINGE else ("N", "m", "m/s")
        gain, bias = compiled.actuator_gainprm[k, 0], compiled.actuator_biasprm[k]
        if bias_type == int(mujoco.mjtBias.mjBIAS_NONE):
            return units[0] if gain == 1.0 else ""
        if bias_type == int(mujoco.mjtBias.mjBIAS_AFFINE):
            return units[1] if bias[1] == -gain else units[2] if bias[2] == -gain else ""
        return ""

    def _kind(self, joint: int) -> Any:
        # An enumeration: bare numbers of the model do not compare with one.
        return self.mujoco.mjtJoint(int(self.compiled.jnt_type[joint]))

    def _joint(self, k: int) -> tuple[list[Variable], list[Variable]]:
        """Its positions and its velocities."""
        kinds, joint = self.mujoco.mjtJoint, self.compiled.joint(k)
        label, kind, who = _label(joint.name, "joint", k), self._kind(k), f"joint {joint.name or k}"
        if kind in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
            unit, what = ("rad", "Angle") if kind == kinds.mjJNT_HINGE else ("m", "Position")
            q = Variable(f"qpos.{label}", 0.0, unit, f"{what} of {who}")
            return [q], [Variable(f"qvel.{label}", 0.0, f"{unit}/s", f"Velocity of {who}")]
        turn = _vector(f"qpos.{label}.quaternion", 4, "1", f"Orientation of {who}")
        rate = _vector(f"qvel.{label}.rate", 3, "rad/s", f"Angular velocity of {who}, in its own frame")
        if kind == kinds.mjJNT_BALL:
            return turn, rate
        place = _vector(f"qpos.{label}.position", 3, "m", f"Position of {who}")
        return place + turn, _vector(
            f"qvel.{label}.velocity", 3, "m/s", f"Velocity of {who}, in the world"
        ) + rate

    def _sensor(self, k: int) -> list[Variable]:
        compiled = self.compiled
        sensor, dim = compiled.sensor(k), int(compiled.sensor_dim[k])
        kind = self.mujoco.mjtSensor(int(compiled.sensor_type[k])).name.removeprefix("mjSENS_")
        unit = _SENSOR_UNITS.get(kind, "")
        if kind in _JOINT_SENSORS:
            hinge = self._kind(compiled.sensor_objid[k]) == self.mujoco.mjtJoint.mjJNT_HINGE
            unit = _JOINT_SENSORS[kind][not hinge]
        base, text = (
            f"sensor.{_label(sensor.name, 'sensor', k)}",
            f"Sensor {sensor.name or k}, {kind.lower()}",
        )
        return [Variable(base, 0.0, unit, text)] if dim == 1 else _vector(base, dim, unit, text)


def _label(name: str, kind: str, k: int) -> str:
    return name if _PLAIN.fullmatch(name) else f"{kind}{k}"


def _vector(base: str, count: int, unit: str, text: str) -> list[Variable]:
    return [Variable(f"{base}[{i}]", 0.0, unit, text) for i in range(count)]


def _header(facts: _Facts, name: str, xml: str, body: int) -> str:
    """pf_mujoco_model.h; the XML in numbers, as a C compiler need not take long strings."""
    compiled = facts.compiled
    sizes = {
        "NQ": compiled.nq,
        "NV": compiled.nv,
        "NU": compiled.nu,
        "NSENSORDATA": compiled.nsensordata,
        "STATE": facts.state,
        "BODY": body,
    }
    defined = "\n".join(f"#define PF_MUJOCO_{key} {value}" for key, value in sizes.items())
    start = ", ".join(repr(float(value)) for value in facts.start)
    data = [*xml.encode("utf-8"), 0]
    lines = (data[i : i + _NUMBERS_A_LINE] for i in range(0, len(data), _NUMBERS_A_LINE))
    numbers = ",\n".join(",".join(str(byte if byte < 128 else byte - 256) for byte in line) for line in lines)
    return f"""\
/* Generated, for MuJoCo {facts.mujoco.__version__}. */
#define PF_MUJOCO_NAME "{name}"
{defined}
#define PF_MUJOCO_TIMESTEP {float(compiled.opt.timestep)!r}
#define PF_MUJOCO_START {{{start}}}
static const char PF_MUJOCO_XML[] = {{
{numbers}}};
"""


def _model(facts: _Facts, name: str, header: str, *, pushed: bool) -> CModel:
    push = _vector("force", 3, "N", "Force on the body, in the world") if pushed else []
    inputs = (*facts.inputs, *push)
    outputs = (*facts.positions, *facts.velocities, *facts.sensors)
    shell = resources.files("phyfilter_ctl.fmi") / "shell"
    code = (shell / "pf_mujoco.c").read_text(encoding="utf-8")
    return CModel(
        name=name,
        sources={"pf_mujoco.c": code, "pf_mujoco_model.h": header},
        symbol="pf_mujoco",
        states=(),
        inputs=inputs,
        outputs=outputs,
        parameters=facts.parameters,
        communication=float(facts.compiled.opt.timestep),
        depends=np.zeros((len(outputs), len(inputs)), dtype=bool),
        description=f"{name}, simulated by MuJoCo",
    )


def _licences(version: str) -> dict[str, bytes | str]:
    """MuJoCo's own and those of what it is made of."""
    found = {
        Path(str(entry)).name: Path(str(entry.locate())).read_bytes()
        for entry in metadata.files("mujoco") or ()
        if "licenses/" in str(entry)
    }
    if "LICENSE" not in found:
        raise FileNotFoundError("the licence of MuJoCo is not beside it; install it from its wheel")
    entries: dict[str, bytes | str] = {
        f"documentation/licenses/mujoco_{key}": text for key, text in found.items()
    }
    entries["documentation/licenses/license.txt"] = (
        f"MuJoCo {version}, inside this FMU as a shared library: Apache License 2.0, see mujoco_LICENSE.\n"
        "What MuJoCo is made of: see mujoco_LICENSES_THIRD_PARTY.md.\n"
    )
    return entries
