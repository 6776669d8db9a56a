"""FMUs (FMI 2.0 and 3.0) and system structure packages: written, read, checked, run together."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .archive import ArchiveLimits
from .check import check
from .check_report import CheckReport, Finding
from .clock_schedule import FmuClock
from .cosimulation import CosimulationResponse, cosimulate
from .cosimulation_wiring import Wire
from .description import FmuExperiment, FmuSolver
from .export import export_fmu
from .fmu import Fmu
from .foreign import Isolation
from .handover import HandOver, hand_over
from .importing import import_fmu
from .importing_model import FmuModel
from .importing_steps import FmuSteps
from .inspect import FmuDescription, FmuKind, FmuVariable, describe
from .instance import FmuError
from .mujoco import export_mujoco_fmu
from .ports import FmuPorts
from .replay import Reference, replay
from .ssp import export_ssp, write_ssp
from .ssp_cut import cut_diagram
from .ssp_read import read_ssp
from .stepping import Master
from .system import System
from .units import FmuUnit
from .unpacked import UnpackedFmu

__all__ = [
    "ArchiveLimits",
    "CheckReport",
    "CosimulationResponse",
    "Finding",
    "Fmu",
    "FmuClock",
    "FmuDescription",
    "FmuError",
    "FmuExperiment",
    "FmuKind",
    "FmuModel",
    "FmuPorts",
    "FmuSolver",
    "FmuSteps",
    "FmuUnit",
    "FmuVariable",
    "HandOver",
    "Isolation",
    "Master",
    "Reference",
    "System",
    "UnpackedFmu",
    "Wire",
    "check",
    "cosimulate",
    "cut_diagram",
    "describe",
    "export_fmu",
    "export_mujoco_fmu",
    "export_ssp",
    "hand_over",
    "import_fmu",
    "read_ssp",
    "replay",
    "write_ssp",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
