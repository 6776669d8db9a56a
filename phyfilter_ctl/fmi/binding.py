"""FMPy's binding of an FMU's functions, loaded without a change of the working folder.

Free of the package's other rooms, so that the process of a foreign binary starts in a fifth of a second.
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from typing import Any, Literal

import fmpy
from fmpy import fmi2, fmi3
from fmpy.fmi1 import _FMU

from .._intake import inside
from .messages import MessageLog, fmi2_callbacks

__all__ = ["BindingError", "bind"]

_FMI2_FOLDERS = {"x86_64-linux": "linux64", "x86_64-windows": "win64", "x86_64-darwin": "darwin64"}


class BindingError(RuntimeError):
    """A binary cannot be loaded, or makes no instance.

    Parameters
    ----------
    call : str
        "load the binary" or "Instantiate".
    message : str
    """

    def __init__(self, call: str, message: str) -> None:
        super().__init__(message)
        self.call = call


_Bytes = ctypes.POINTER(ctypes.c_uint8)


class _Loader(_FMU):
    """Stands between FMPy's FMI classes and their base, whose loader changes the working folder of all threads.

    Libraries beside the binary are found all the same: by its run path, on Windows by its full path.
    """

    def __init__(
        self,
        *,
        guid: str,
        modelIdentifier: str,  # FMPy's names
        unzipDirectory: str,
        instanceName: str,
        libraryPath: str,
    ) -> None:
        self.guid, self.modelIdentifier = guid, modelIdentifier
        self.unzipDirectory, self.instanceName = unzipDirectory, instanceName
        self.fmiCallLogger, self.requireFunctions = None, True
        self._functions: dict[str, Any] = {}
        if not os.path.isfile(libraryPath):
            raise FileNotFoundError(f"there is no {libraryPath}")
        self.dll = ctypes.CDLL(libraryPath)
        self._loadFunctions()
        self.component = ctypes.c_void_p()
        self.callbacks = None

    def getOpaque(self, kind: str, references: list[int], count: int) -> list[str]:  # as FMPy names its own
        """Elements of String variables as they are, of Binary variables as hexadecimal digits: both can travel."""
        places, fmu = (ctypes.c_uint * len(references))(*references), self._functions_of_fmi
        if kind == "Binary":
            bytes_, sizes = (_Bytes * count)(), (ctypes.c_size_t * count)()
            fmu.fmi3GetBinary(self.component, places, len(references), sizes, bytes_, count)
            return [
                ctypes.string_at(pointer, size).hex() if size else ""
                for pointer, size in zip(bytes_, sizes, strict=True)
            ]
        texts = (ctypes.c_char_p * count)()
        if self._two:
            fmu.fmi2GetString(self.component, places, len(references), texts)
        else:
            fmu.fmi3GetString(self.component, places, len(references), texts, count)
        return [(text or b"").decode("utf-8", "replace") for text in texts]

    def setOpaque(self, kind: str, references: list[int], words: list[str]) -> None:
        """As :meth:`getOpaque` has them."""
        places, fmu, count = (
            (ctypes.c_uint * len(references))(*references),
            self._functions_of_fmi,
            len(words),
        )
        if kind == "Binary":
            data = [bytes.fromhex(word) for word in words]
            buffers = [(ctypes.c_uint8 * max(len(each), 1)).from_buffer_copy(each or b"\0") for each in data]
            bytes_ = (_Bytes * count)(*(ctypes.cast(buffer, _Bytes) for buffer in buffers))
            sizes = (ctypes.c_size_t * count)(*map(len, data))
            fmu.fmi3SetBinary(self.component, places, len(references), sizes, bytes_, count)
            return
        texts = (ctypes.c_char_p * count)(*(word.encode("utf-8") for word in words))
        if self._two:
            fmu.fmi2SetString(self.component, places, len(references), texts)
        else:
            fmu.fmi3SetString(self.component, places, len(references), texts, count)

    @property
    def _two(self) -> bool:
        return isinstance(self, fmi2._FMU2)

    @property
    def _functions_of_fmi(self) -> Any:
        """This object, of whose functions the type checker knows nothing: FMPy's class comes in front of this one."""
        return self


class _Cosimulated(fmi3.FMU3Slave):
    """Co-simulation that keeps what the FMU tells inside its steps."""

    watched: tuple[list[int], int] = [], 0
    _failed: Exception | None = None

    def hear(
        self, _: object, time: float, settable: bool, gettable: bool, finished: bool, may_return: bool,
        returns: Any, until: object,
    ) -> None:  # fmt: skip
        """The FMU's callback: values now, where they may be read."""
        returns[0] = False
        if gettable:
            try:
                self._heard.append([time, *self.getFloat64(*self.watched)])
            except Exception as error:  # an exception cannot pass through the FMU: it is raised behind it
                self._failed = error

    def takeHeard(self) -> list[list[float]]:  # as FMPy names its own
        """Time and values of all since it was asked last."""
        failed, self._failed = self._failed, None
        if failed is not None:
            raise failed
        found, self._heard = self._heard, []
        return found

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._heard: list[list[float]] = []


class _Scheduled(fmi3.FMU3ScheduledExecution):
    """Scheduled execution that hears what the FMU tells in its callback of clocks, one partition after another."""

    def instantiate(
        self, visible: bool = False, loggingOn: bool = False, logMessage: Any = None
    ) -> None:  # FMPy's names
        """Make the instance."""

        def nothing() -> None:
            """Partitions never run at the same time here."""

        self.logMessage = fmi3.fmi3LogMessageCallback(logMessage)
        self.clockUpdate = fmi3.fmi3ClockUpdateCallback(lambda _: self._hear())
        self.lockPreemption = fmi3.fmi3LockPreemptionCallback(nothing)
        self.unlockPreemption = fmi3.fmi3UnlockPreemptionCallback(nothing)
        self._asked: tuple[list[int], list[int]] = [], []
        self._told: dict[int, float] = {}
        self._rung: list[int] = []
        self._failed: Exception | None = None
        self.component = self.fmi3InstantiateScheduledExecution(
            self.instanceName.encode(), self.guid.encode(),
            (os.path.join(self.unzipDirectory, "resources") + os.path.sep).encode(),
            fmi3.fmi3Boolean(visible), fmi3.fmi3Boolean(loggingOn), fmi3.fmi3InstanceEnvironment(),
            self.logMessage, self.clockUpdate, self.lockPreemption, self.unlockPreemption,
        )  # fmt: skip
        if not self.component:
            raise RuntimeError("Instantiate answered NULL")

    def activate(
        self, clock: int, time: float, intervals: list[int], clocks: list[int]
    ) -> tuple[list[tuple[int, float]], list[int]]:
        """Activate a partition: new intervals of the first, by reference, and which of the second ticked."""
        self._asked, self._told, self._rung, self._failed = (intervals, clocks), {}, [], None
        self.activateModelPartition(clock, time)
        self._hear()
        if self._failed is not None:
            raise self._failed
        return list(self._told.items()), self._rung

    def _hear(self) -> None:
        intervals, clocks = self._asked
        try:
            if intervals:
                count = len(intervals)
                references = (ctypes.c_uint * count)(*intervals)
                found, qualifiers = (ctypes.c_double * count)(), (ctypes.c_int * count)()
                self.getIntervalDecimal(references, found, qualifiers)
                self._told |= {
                    reference: interval
                    for reference, interval, qualifier in zip(intervals, found, qualifiers, strict=True)
                    if qualifier == fmi3.fmi3IntervalChanged
                }
            if clocks:
                on = self.getClock(clocks)
                self._rung += [reference for reference, active in zip(clocks, on, strict=True) if active]
        except Exception as error:  # an exception cannot pass through the FMU: it is raised behind it
            self._failed = error


_CLASSES: dict[tuple[str, str], Any] = {
    (fmi, kind): type(base.__name__, (base, _Loader), {})
    for fmi, kind, base in (
        ("2.0", "me", fmi2.FMU2Model),
        ("2.0", "cs", fmi2.FMU2Slave),
        ("3.0", "me", fmi3.FMU3Model),
        ("3.0", "cs", _Cosimulated),
        ("3.0", "se", _Scheduled),
    )
}


def bind(
    log: MessageLog,
    *,
    fmi: str,
    kind: Literal["me", "cs", "se"],
    folder: str,
    identifier: str,
    token: str,
    name: str,
    event_mode: bool = False,
    intermediate: tuple[list[int], int] | None = None,
) -> Any:
    """An instance of an unpacked FMU: an object of FMPy's classes.

    Parameters
    ----------
    log : MessageLog
        Must live as long as the instance.
    fmi : str
        "2.0" or "3.0".
    kind : {"me", "cs", "se"}
    folder, identifier, token, name : str
        Of the unpacked FMU, of the binary, GUID or instantiation token, of the instance.
    event_mode : bool
        Whether co-simulation is to use Event Mode, and may return early.
    intermediate : tuple of list of int and int, optional
        Variables that co-simulation is to tell of inside its steps, and how many numbers they are.

    Raises
    ------
    BindingError
    """
    library = _library(Path(folder), identifier, fmi)
    if not inside(library, Path(folder)):
        raise BindingError(
            "load the binary", f"modelIdentifier {identifier!r}: expected a library inside the FMU; refused"
        )
    try:
        fmu = _CLASSES[fmi, kind](
            guid=token,
            modelIdentifier=identifier,
            unzipDirectory=folder,
            instanceName=name,
            libraryPath=str(library),
        )
    except (OSError, AttributeError) as error:  # AttributeError: a function of FMI is missing
        raise BindingError("load the binary", _explained(str(error), library)) from error
    try:
        if fmi == "2.0":
            fmu.instantiate(callbacks=fmi2_callbacks(log))
        else:
            options: dict[str, Any] = (
                {"eventModeUsed": True, "earlyReturnAllowed": True} if event_mode else {}
            )
            if intermediate is not None:
                fmu.watched = intermediate
                options |= {"intermediateUpdate": fmu.hear, "requiredIntermediateVariables": intermediate[0]}
            fmu.instantiate(
                logMessage=lambda _, status, category, text: log.add(status, category, text), **options
            )
    except Exception as error:  # FMPy raises a bare exception where the FMU returns NULL
        fmu.freeLibrary()
        raise BindingError("Instantiate", log.latest() or str(error)) from error
    return fmu


def _library(folder: Path, identifier: str, fmi: str) -> Path:
    here = fmpy.platform_tuple
    names = [here, *([_FMI2_FOLDERS[here]] if fmi == "2.0" and here in _FMI2_FOLDERS else [])]
    found = [folder / "binaries" / name / (identifier + fmpy.sharedLibraryExtension) for name in names]
    return next((path for path in found if path.is_file()), found[-1])


def _explained(error: str, library: Path) -> str:
    """The loader's words, and the width of the binary where that is what is wrong with it."""
    wide = ctypes.sizeof(ctypes.c_void_p) == 8
    with library.open("rb") if library.is_file() else open(os.devnull, "rb") as file:
        head = file.read(5)
    if wide and head == b"\x7fELF\x01":
        return f"{library.name} is a 32-bit binary, and this Python is a 64-bit one: {error}"
    return error
