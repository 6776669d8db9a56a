"""C for microcontrollers, simulations and FMUs."""

from .binding import Library
from .compiled import CompiledModel, CompiledRun, compile_model
from .compiler import Compiler, CompilerError, cached_library, compile_sources, find_compiler
from .diagram_source import diagram_model
from .export import export_c
from .export_diagram import export_diagram
from .export_filter import export_filter
from .export_folder import write_folder
from .export_target import export_target
from .filter_model import filter_model
from .filter_source import FilterSource, filter_source
from .instance import Instance
from .model import CModel

__all__ = [
    "CModel",
    "CompiledModel",
    "CompiledRun",
    "Compiler",
    "CompilerError",
    "FilterSource",
    "Instance",
    "Library",
    "cached_library",
    "compile_model",
    "compile_sources",
    "diagram_model",
    "export_c",
    "export_diagram",
    "export_filter",
    "export_target",
    "filter_model",
    "filter_source",
    "find_compiler",
    "write_folder",
]
