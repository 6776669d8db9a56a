"""FMUs (FMI 2.0 and 3.0) and system structure packages: written, read, checked, run together."""

from .archive import ArchiveLimits
from .check import check
from .check_report import CheckReport, Finding
from .clock_schedule import FmuClock
from .cosimulation import CosimulationResponse, cosimulate
from .cosimulation_wiring import Wire
from .description import FmuExperiment, FmuSolver
from .export import export_fmu
from .foreign import Isolation
from .handover import HandOver, hand_over
from .importing import import_fmu
from .importing_blocks import FmuBlock
from .importing_model import FmuModel
from .importing_steps import FmuSteps
from .inspect import FmuDescription, FmuKind, FmuVariable, describe
from .instance import FmuError
from .late_wires import late_wires
from .mujoco import export_mujoco_fmu
from .replay import Reference, read_reference, replay, replay_in_fmpy, write_reference
from .ssp import export_ssp, write_ssp
from .ssp_cut import CutDiagram, cut_diagram
from .units import FmuUnit
from .unpacked import UnpackedFmu

__all__ = [
    "ArchiveLimits",
    "CheckReport",
    "CosimulationResponse",
    "CutDiagram",
    "Finding",
    "FmuBlock",
    "FmuClock",
    "FmuDescription",
    "FmuError",
    "FmuExperiment",
    "FmuKind",
    "FmuModel",
    "FmuSolver",
    "FmuSteps",
    "FmuUnit",
    "FmuVariable",
    "HandOver",
    "Isolation",
    "Reference",
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
    "late_wires",
    "read_reference",
    "replay",
    "replay_in_fmpy",
    "write_reference",
    "write_ssp",
]
