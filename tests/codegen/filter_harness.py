"""Filters as C, called from Python: compiled once for many of them, driven like SampledPhyFilter."""

import ctypes
from pathlib import Path

import numpy as np

from phyfilter_ctl.codegen.compiler import compile_sources
from phyfilter_ctl.codegen.filter_code import FilterSource

STRICT = (
    *(
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Wshadow",
        "-Wconversion",
        "-Wdouble-promotion",
        "-Wmissing-prototypes",
    ),
    *("-Werror", "-fvisibility=default", "-O0"),
)


def compile_filters(sources: list[FilterSource], folder: Path, compiler=None) -> ctypes.CDLL:
    """One library of many filters."""
    texts = {file: text for source in sources for file, text in source.sources.items()}
    texts["sizes.c"] = "".join(
        f'#include "{source.name}.h"\nsize_t {source.name}_size(void);\n'
        f"size_t {source.name}_size(void) {{ return sizeof({source.name}); }}\n"
        for source in sources
    )
    return ctypes.CDLL(str(compile_sources(texts, folder / "filters.so", compiler=compiler, flags=STRICT)))


class CFilter:
    """One instance; vectors in the C type, results as arrays."""

    def __init__(self, library: ctypes.CDLL, source: FilterSource) -> None:
        self.source, self.library = source, library
        self.dtype = np.dtype(np.float32 if source.real == "float" else np.float64)
        size = self._function("size")
        size.restype = ctypes.c_size_t
        # Guard bytes behind the instance show writes past its end.
        self.size = size()
        self.memory = np.full(self.size + 64, 0xA5, np.uint8)
        code = self._function("init")(self._self(), self._address(f"{source.name}_parameters"))
        assert code == 0, code

    def _function(self, suffix: str):
        return self.library[f"{self.source.name}_{suffix}"]

    def _address(self, symbol: str) -> ctypes.c_void_p:
        return ctypes.c_void_p(ctypes.addressof(ctypes.c_char.in_dll(self.library, symbol)))

    def _self(self) -> ctypes.c_void_p:
        return ctypes.c_void_p(self.memory.ctypes.data)

    def call(self, suffix: str, *arguments) -> int:
        """Arrays go as pointers to the C type (doubles for retune), None as NULL, floats as double."""
        kept, given = [], []
        for value in arguments:
            if type(value) is float:  # a numpy number is an array of one
                given.append(ctypes.c_double(value))
            elif value is None:
                given.append(None)
            else:
                kept.append(np.ascontiguousarray(value, None if suffix.startswith("retune") else self.dtype))
                given.append(ctypes.c_void_p(kept[-1].ctypes.data))
        code = self._function(suffix)(self._self(), *given)
        assert np.all(self.memory[self.size :] == 0xA5), "written past the end of the instance"
        return code

    def start(self, x0, f_hat0=None, f_theta0=None, inertia0=None, g0=None) -> int:
        return self.call("start", x0, f_hat0, f_theta0, inertia0, g0)

    def step(self, x, g, f_theta, inertia=None, dt=None, *, name="step"):
        f_hat = np.full(self.source.n_f, np.nan, self.dtype)
        if dt is None:
            code = self.call(name, x, g, f_theta, inertia, f_hat)
        else:
            code = self.call(f"{name}_after", x, g, f_theta, inertia, float(dt), f_hat)
        return code, f_hat

    def retune(self, a, b) -> int:
        """One row of coefficients per filter; short ones are padded."""
        n = max(self.source.orders)
        padded = [np.array([np.pad(row, (0, n - len(row))) for row in rows], dtype=float) for rows in (a, b)]
        return self.call("retune", *padded)
