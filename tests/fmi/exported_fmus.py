"""FMUs exported by the library for the tests, and one way of calling them all through fmpy's thin wrappers."""

import atexit
import ctypes
import shutil
import tempfile
from functools import cache
from pathlib import Path

import control as ct
import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException

import phyfilter_ctl as pf
from phyfilter_ctl.codegen import find_compiler
from phyfilter_ctl.fmi import FmuPorts, export_fmu

FOLDER = Path(tempfile.mkdtemp(prefix="exported_fmus_"))
atexit.register(shutil.rmtree, FOLDER, ignore_errors=True)
PERIOD = 0.002
FILTER = pf.PhyFilter([400.0, 40.0])
GENERAL = pf.PhyFilter([8000.0, 1200.0, 60.0], [8000.0, 1200.0, 0.0])


def oscillator():
    def swing(t, x, u, p):
        return {
            "place": x.speed,
            "speed": (u.force - p.stiffness * x.place - p.damping * x.speed) / p.mass,
        }, {
            "place": x.place,
            "pull": p.stiffness * x.place,
        }

    return pf.plant(
        swing,
        states={"place": (1.0, "m"), "speed": (0.0, "m/s")},
        inputs={"force": (0.0, "N")},
        outputs={"place": "m", "pull": "N"},
        params={"mass": (2.0, "kg"), "stiffness": (8.0, "N/m"), "damping": (0.4, "N s/m")},
    )


def closed_loop():
    """Plant with drag, a sampled PD law at 50 Hz and a sampled filter at 200 Hz."""

    def body(t, x, u, p):
        return {"v": (u.thrust - p.drag * x.v * (x.v**2 + 1.0) ** 0.5) / p.mass, "s": x.v}

    plant = pf.plant(
        body,
        states={"v": (0.0, "m/s"), "s": (0.0, "m")},
        inputs={"thrust": (0.0, "N")},
        params={"drag": (0.3, "kg/m"), "mass": (1.2, "kg")},
        name="plant",
    )
    law = ct.ss(
        [], [], [], [[4.0, -4.0, -3.0]], dt=0.02, inputs=["goal", "s", "v"], outputs=["u"], name="law"
    )
    observer = pf.sampled_block(FILTER.sampled(0.005), channels=1, name="observer")
    return ct.interconnect(
        [plant, pf.sampled_block(law, name="law"), observer],
        connections=[
            ["plant.thrust", "law.u"], ["law.s", "plant.s"], ["law.v", "plant.v"],
            ["observer.x[0]", "plant.v"], ["observer.g[0]", "law.u"],
        ],
        inplist=["law.goal", "observer.f_theta[0]"], inputs=["goal", "f_theta"],
        outlist=["plant.s", "plant.v", "observer.f_hat[0]"], outputs=["s", "v", "f_hat"], name="loop",
    )  # fmt: skip


SYSTEMS = {
    "sampled": lambda: (FILTER.sampled(PERIOD, channels=3), {}),
    "fixed": lambda: (GENERAL.sampled(PERIOD, channels=2), {"rate": "fixed"}),
    "continuous": lambda: (GENERAL, {"ports": FmuPorts(channels=2)}),
    "oscillator": lambda: (oscillator(), {}),
    "loop": lambda: (closed_loop(), {}),
}
MODELS = tuple(SYSTEMS)


@cache
def quick_compiler():
    """The default one without optimisation, which takes a third of the time; contraction is off in any case."""
    command = find_compiler().command
    return command if len(command) > 1 else ("sh", "-c", f'exec {command[0]} "$@" -O0', command[0])


@cache
def exported(name, fmi, **options):
    system, more = SYSTEMS[name]()
    options.setdefault("compiler", quick_compiler())
    path = FOLDER / f"{name}_{fmi[0]}_{len(list(FOLDER.iterdir()))}.fmu"
    return export_fmu(system, path, fmi=fmi, name=f"{name}_model", **more, **options)


@cache
def unpacked(path):
    return Path(fmpy.extract(str(path), unzipdir=str(path.with_suffix(""))))


@cache
def described(path):
    return fmpy.read_model_description(str(path))


class Instance:
    """One instance, with variables by name: of arrays and of scalars with indices alike, `x` is all of x."""

    def __init__(
        self, path, kind="cs", *, log=None, event_mode=False, early_return=False, intermediate=None, **setup
    ):
        self.description = described(path)
        self.two = self.description.fmiVersion == "2.0"
        self.kind = kind
        self.messages = []
        self.fmu = fmpy.simulation.instantiate_fmu(
            str(unpacked(path)), self.description, "CoSimulation" if kind == "cs" else "ModelExchange",
            debug_logging=False, logger=self._log, event_mode_used=event_mode, early_return_allowed=early_return,
            intermediate_update=intermediate,
        )  # fmt: skip
        self.event_mode = event_mode
        self.setup = setup
        self.time = setup.get("startTime", 0.0)

    def _log(self, *arguments):
        self.messages.append(
            arguments[-1].decode() if isinstance(arguments[-1], bytes) else str(arguments[-1])
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.fmu.freeInstance()

    def references(self, name):
        found = [
            v for v in self.description.modelVariables if v.name == name or v.name.startswith(f"{name}[")
        ]
        assert found, f"no variable {name}"
        count = sum(int(np.prod(v.shape)) for v in found)
        return [v.valueReference for v in found], count

    def set(self, **values):
        for name, value in values.items():
            refs, count = self.references(name.replace("__", "."))
            flat = np.broadcast_to(np.asarray(value, float), (count,)).tolist()
            self.fmu.setReal(refs, flat) if self.two else self.fmu.setFloat64(refs, flat)
        return self

    def get(self, *names):
        parts = []
        for name in names:
            refs, count = self.references(name)
            parts += self.fmu.getReal(refs) if self.two else self.fmu.getFloat64(refs, count)
        return np.array(parts)

    def enter(self):
        if self.two:
            self.fmu.setupExperiment(**self.setup)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(**self.setup)
        return self

    def start(self, **values):
        self.enter().set(**values)
        self.fmu.exitInitializationMode()
        if self.kind == "me" or self.event_mode:
            self.update()
            self.fmu.enterContinuousTimeMode() if self.kind == "me" else self.fmu.enterStepMode()
        return self

    def update(self):
        """Event iteration: the time of the next event, None where there is none."""
        answer = self.fmu.newDiscreteStates() if self.two else self.fmu.updateDiscreteStates()
        assert not answer[0]
        return answer[5] if answer[4] else None

    def step(self, h, **values):
        self.set(**values)
        answer = self.fmu.doStep(self.time, h)
        self.time = self.time + h if self.two or not answer[2] else answer[3]
        return answer

    def save(self):
        return self.fmu.getFMUState() if not self.two else self.fmu.getFMUstate()

    def restore(self, state):
        self.fmu.setFMUState(state) if not self.two else self.fmu.setFMUstate(state)

    def free(self, state):
        self.fmu.freeFMUState(state) if not self.two else self.fmu.freeFMUstate(state)


def refused(call, *arguments, **keywords):
    """Status of a call that must fail."""
    try:
        call(*arguments, **keywords)
    except FMICallException as error:
        return error.status
    raise AssertionError("the call was accepted")


def doubles(n):
    return (ctypes.c_double * n)()
