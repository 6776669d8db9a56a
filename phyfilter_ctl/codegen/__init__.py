"""C for microcontrollers, simulations and FMUs."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .binding import Library
from .compiled import CompiledModel, CompiledRun, compile_model
from .compiler import Compiler, CompilerError, find_compiler
from .export import export_c
from .export_target import export_target
from .instance import Instance
from .model import CModel

__all__ = [
    "CModel",
    "CompiledModel",
    "CompiledRun",
    "Compiler",
    "CompilerError",
    "Instance",
    "Library",
    "compile_model",
    "export_c",
    "export_target",
    "find_compiler",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
