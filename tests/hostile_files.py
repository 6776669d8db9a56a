"""Hand-made hostile files and what every entry point says of them: ``python -m tests.hostile_files`` prints the table.

Each file is small and would take much memory or time, reach for another file, or hold a number or a nesting that no
reader expects. The command runs all rows in one process of limited memory.
"""

from __future__ import annotations

import io
import json
import re
import struct
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl import robot
from phyfilter_ctl.app.sessions import load_session
from phyfilter_ctl.cli import main as command
from phyfilter_ctl.execution import Checkpoint
from phyfilter_ctl.fmi import FmuError, check, cosimulate, describe, import_fmu
from phyfilter_ctl.fmi.recipes import read_recipe
from phyfilter_ctl.learned import learned_model
from phyfilter_ctl.learned.onnx import OnnxNetwork
from phyfilter_ctl.logfiles import read_recording
from phyfilter_ctl.study import read_parameters
from tests.fmi.foreign_fmus import description

MEMORY = 2 << 30  # bytes of address space beyond what the imports took
LARGEST = 1 << 20  # bytes, where a file of the default limit would take seconds to make
BIG = "1" + "0" * 400
ROBOT = 'format = "phyfilter-robot"\nversion = 1\n[signals]\nv = { field = "v", unit = "m/s" }\n'
LOG = "t_s,v\n0.0,1.0\n0.1,1.1\n0.2,1.2\n"
TIMES = np.linspace(0.0, 1.0, 11)


@dataclass(frozen=True)
class Row:
    """An entry point, what is wrong with the file, the words that come out, and how both are made."""

    entry: str
    wrong: str
    words: str
    make: Callable[[Path], Path]
    enter: Callable[[Path], object]
    package: str = "numpy"

    @property
    def name(self) -> str:
        return f"{self.entry}: {self.wrong}"


def said(row: Row, folder: Path) -> str:
    """What comes out of the row, in a folder of its own; anything but a refusal is raised."""
    path = row.make(folder)
    before = sorted(folder.rglob("*"))
    out = io.StringIO()
    try:
        with redirect_stdout(out), redirect_stderr(out):
            result = row.enter(path)
    except (ValueError, OSError, FmuError) as error:
        text = str(error)
    else:
        text = f"{result} {out.getvalue()}"
    assert re.search(row.words, text), f"expected {row.words!r}, got {text[:500]!r}"
    assert str(path) in text, f"the file is not named: {text[:500]!r}"
    assert sorted(folder.rglob("*")) == before, "something was left beside the file"
    return text


# -- logs -------------------------------------------------------------------------------------------------------------


def opened(path: Path) -> object:
    """A log, and all of its topics."""
    log = pf.open_log(path, largest=LARGEST)
    return [log.read(topic.name) for topic in log.topics]


def hdf5(path: Path) -> Path:
    """4 kB that say 8 GB."""
    import h5py

    with h5py.File(path, "w") as file:
        for name in ("t_s", "v"):
            file.create_dataset(name, (10**9,), "f8", chunks=(1000,))
    return path


def hdf5_chunk(path: Path) -> Path:
    """A chunk of 2 GB around two numbers."""
    import h5py

    with h5py.File(path, "w") as file:
        file["t_s"] = np.arange(2.0)
        file.create_dataset("v", (2,), "f8", chunks=(1 << 28,), maxshape=(None,))
    return path


def hdf5_external(path: Path) -> Path:
    import h5py

    secret = path.with_name("secret.bin")
    secret.write_bytes(bytes(80))
    with h5py.File(path, "w") as file:
        file["t_s"] = np.arange(10.0)
        file.create_dataset("v", (10,), "f8", external=[(str(secret), 0, 80)])
    return path


def hdf5_packed(path: Path) -> Path:
    """A chunk of 8 kB that unpacks to 16 MB."""
    import h5py

    with h5py.File(path, "w") as file:
        file["t_s"] = np.arange(1000.0)
        made = file.create_dataset("v", (1000,), "f8", chunks=(1000,), compression="gzip")
        made.id.write_direct_chunk((0,), zlib.compress(bytes(1 << 24)))
    return path


def hdf5_matrix(path: Path) -> Path:
    """Times that fit, and a matrix beside them that does not."""
    import h5py

    with h5py.File(path, "w") as file:
        file["t_s"] = np.arange(1000.0)
        file.create_dataset("v", (1000, 256), "f8", chunks=(10, 256))
    return path


def element(kind: int, data: bytes) -> bytes:
    """One of MATLAB's version-5 files."""
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(kind: int, shape: tuple[int, int], name: bytes, *inside: bytes) -> bytes:
    head = element(6, struct.pack("<II", kind, 0)) + element(5, struct.pack("<2i", *shape)) + element(1, name)
    return element(14, head + b"".join(inside))


def mat(path: Path, *variables: bytes) -> Path:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    packed = [zlib.compress(variable) for variable in variables]
    path.write_bytes(head + b"".join(struct.pack("<II", 15, len(each)) + each for each in packed))
    return path


def mat_zeros(path: Path) -> Path:
    """16 MB of zeros in 16 kB."""
    return mat(path, matrix(6, (1, 1 << 21), b"t", element(9, bytes(1 << 24))))


def mat_fields(path: Path) -> Path:
    """A million fields whose names have one byte, in 2 kB."""
    fields = element(5, struct.pack("<i", 1)) + element(1, bytes(1_000_000))
    return mat(path, matrix(2, (1, 1), b"s", fields))


def csv_line(path: Path) -> Path:
    path.write_text("t_s," * 2_000_000 + "v\n1\n")
    return path


def ulog(path: Path) -> Path:
    """Formats in formats: 60 000^2 elements."""
    from tests.logfiles.ulog_writer import message, ulog

    us = 10_000 * np.arange(1, 21)
    data = ulog({"a": {"timestamp": ("uint64_t", us), "q": ("float", np.ones(20))}})
    formats = message("F", b"x:uint8_t[60000] y;") + message("F", b"w:x[60000] y;")
    path.write_bytes(data[:59] + formats + data[59:])
    return path


def dataflash(path: Path) -> Path:
    """A format that makes more bytes than its message has."""
    from tests.logfiles.dataflash_writer import dataflash

    data = dataflash({"IMU": ("QBf", "TimeUS,I,AccX", "s#o", "F-0")}, [("IMU", (1000, 0, 0.5))])
    path.write_bytes(data.replace(b"QBf\0", b"QBd\0"))
    return path


def crazyflie(path: Path) -> Path:
    """65 535 types of events in 9 bytes."""
    path.write_bytes(b"\xbc\x01\x00\xff\xff" + bytes(4))
    return path


def bag(path: Path, packed: str = "", message: str = "uint8[] data") -> Path:
    """A ROS 1 bag with 4 MB of zeros in a message, or with a list of 16 bytes that says how long it is."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("int32 A=1\n", "x/msg/Nothing"))
    store.register(get_types_from_msg(message + "\n", "x/msg/Much"))
    writer = Writer(path)
    if packed:
        writer.set_compression(Writer.CompressionFormat[packed])
    with writer:
        connection = writer.add_connection("/much", "x/msg/Much", typestore=store)
        data = bytes(4 << 20) if packed else b""
        writer.write(connection, 10**18, struct.pack("<I", len(data) or 400_000_000) + data)
    return path


def bag2(path: Path, mode: str) -> Path:
    """A ROS 2 bag with 64 MB of zeros in a message, packed."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "std_msgs/msg/String"
    storage = StoragePlugin.MCAP if mode == "STORAGE" else StoragePlugin.SQLITE3
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/much", kind, typestore=store)
        writer.write(connection, 10**18, store.serialize_cdr(store.types[kind]("\0" * (64 << 20)), kind))
    return path


def mcap(path: Path) -> Path:
    """A chunk of 64 MB of zeros in 2 kB."""
    return next(bag2(path, "STORAGE").glob("*.mcap"))


def parquet(path: Path) -> Path:
    """A million numbers that are one, in a few kB."""
    import pyarrow as pa
    from pyarrow import parquet

    ones = np.ones(1_000_000)
    parquet.write_table(pa.table({"t_s": ones, "v": ones}), path)
    return path


def arrow(path: Path, is_file: bool) -> Path:
    """8 MB of zeros in a few kB, as a file or a stream."""
    import pyarrow as pa

    table = pa.table({"t_s": np.arange(500_000.0), "v": np.zeros(500_000)})
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    new = pa.ipc.new_file if is_file else pa.ipc.new_stream
    with new(str(path), table.schema, options=options) as writer:
        writer.write_table(table)
    return path


# -- other files ------------------------------------------------------------------------------------------------------


def text(content: str | bytes) -> Callable[[Path], Path]:
    def make(path: Path) -> Path:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return make


def read_by_robot(path: Path) -> object:
    log = path.with_name("log.csv")
    return robot.Robot.load(path).read(log)


def robot_file(content: str) -> Callable[[Path], Path]:
    def make(path: Path) -> Path:
        path.with_name("log.csv").write_text(LOG)
        path.write_text(ROBOT + content)
        return path

    return make


def nested(levels: int, width: int) -> str:
    """Expressions each of which is a list of the one before: width^levels numbers a sample."""
    names = ["v", *(f"e{k}" for k in range(levels))]
    rows = [f'{new} = "[{", ".join([old] * width)}]"\n' for old, new in pairwise(names)]
    return f'[expressions]\n{"".join(rows)}[model]\nx = "{"sum(" * (levels - 1)}{names[-1]}{")" * (levels - 1)}"\n'


def npz(path: Path) -> Path:
    """A packed entry, which could be of any size."""
    with path.open("wb") as file:
        np.savez_compressed(file, W=np.zeros(1_000_000))
    return path


def npz_shape(path: Path) -> Path:
    """An entry of 8 bytes that says 8 TB."""
    held = io.BytesIO()
    np.lib.format.write_array_header_1_0(held, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("W.npy", held.getvalue() + bytes(8))
    return path


def restored(path: Path) -> object:
    live = pf.lowpass(2, 20.0).sampled(0.01).live(1)
    return live.restore(path)


def archive(*entries: tuple[str | zipfile.ZipInfo, str | bytes]) -> Callable[[Path], Path]:
    def make(path: Path) -> Path:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
            for name, data in entries:
                file.writestr(name, data)
        return path

    return make


def fmu(before: str = "", after: str = "", fmi: str = "2.0") -> Callable[[Path], Path]:
    whole = description(fmi)
    assert before in whole
    return archive(("modelDescription.xml", whole.replace(before, after)))


def package(inner: Callable[[Path], Path]) -> Callable[[Path], Path]:
    """An SSP around an FMU."""
    ssd = (
        '<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription" '
        'version="1.0" name="s"><ssd:System name="s"><ssd:Elements><ssd:Component name="a" '
        'type="application/x-fmu-sharedlibrary" source="resources/a.fmu"/></ssd:Elements></ssd:System>'
        "</ssd:SystemStructureDescription>"
    )

    def make(path: Path) -> Path:
        part = inner(path.with_name("a.fmu"))
        archive(("SystemStructure.ssd", ssd), ("resources/a.fmu", part.read_bytes()))(path)
        part.unlink()
        return path

    return make


def link(name: str, target: str) -> tuple[zipfile.ZipInfo, str]:
    entry = zipfile.ZipInfo(name)
    entry.external_attr = 0o120777 << 16
    return entry, target


ELSEWHERE = fmu('modelIdentifier="', 'modelIdentifier="../../evil_')
EXPERIMENT = 'stopTime="2.0" tolerance="1e-6" stepSize="0.01"'


def into(name: str, make: Callable[[Path], Path]) -> Callable[[Path], Path]:
    return lambda folder: make(folder / name)


LISTS = "a = " + "[" * 2000 + "]" * 2000
BRACKETS = "[" * 20_000
FILTER = 'format = "phyfilter"\nversion = 1\na = '
ANSWERS = json.dumps({"study": {}}) + "\n[1]\n"
INDICATORS = 'numberOfEventIndicators="{}"'

# What is wrong, name of the file, how it is made, words, package: all read by `opened`.
LOGS = [
    ("HDF5, another file's bytes", "a.h5", hdf5_external, "from another file", "h5py"),
    ("HDF5, a wide matrix", "a.h5", hdf5_matrix, "allow more by largest", "h5py"),
    ("HDF5, a chunk of 16 MB", "a.h5", hdf5_packed, "bytes of memory for a chunk of '/v'", "h5py"),
    ("MAT 7.3, 8 GB in 4 kB", "a.mat", hdf5, "bytes of memory", "h5py"),
    ("MAT, 16 MB in 16 kB", "a.mat", mat_zeros, "a compressed array", "scipy"),
    ("MAT, a struct of 1e6 fields", "a.mat", mat_fields, "fields of a struct", "numpy"),
    ("CSV, a line of 8 MB", "a.csv", csv_line, "lines of at most", "numpy"),
    ("ULog, formats in formats", "a.ulg", ulog, "at most 65535 elements", "pyulog"),
    ("DataFlash, a longer format", "a.bin", dataflash, "message IMU: expected", "pymavlink"),
    ("Crazyflie, 65535 events", "a.usd", crazyflie, "no readable crazyflie log", "numpy"),
    ("ROS 1, a bz2 chunk", "a.bag", partial(bag, packed="BZ2"), "a packed chunk", "rosbags"),
    ("ROS 1, a lz4 chunk", "a.bag", partial(bag, packed="LZ4"), "a packed chunk", "rosbags"),
    ("ROS 1, 4e8 empty messages", "a.bag", partial(bag, message="x/Nothing[] a"), "with fields", "rosbags"),
    ("ROS 2, a packed message", "a", partial(bag2, mode="MESSAGE"), "a packed message", "rosbags"),
    ("ROS 2, a packed file", "a", partial(bag2, mode="FILE"), r"db3\.zstd", "rosbags"),
    ("MCAP, a chunk of 64 MB", "a", mcap, "a packed chunk", "rosbags"),
    ("Arrow, 8 MB packed", "a.arrow", partial(arrow, is_file=True), "8000000 bytes .*packed col", "pyarrow"),
    (
        "Arrow, a packed stream",
        "a.arrow",
        partial(arrow, is_file=False),
        "8000000 bytes .*packed col",
        "pyarrow",
    ),
    ("Parquet, a million ones", "a.parquet", parquet, "bytes of memory", "pyarrow"),
]

# What is wrong, the file's end, words, entry.
ROBOTS = [
    (
        "a number of 401 digits",
        f'[constants]\nm = {BIG}\n[model]\nx = "v"\n',
        "constants.m: expected a finite",
        "load",
    ),
    (
        "401 digits in an expression",
        f'[model]\nx = "v"\nM = "{BIG}"\n',
        "model.M: a number: too large",
        "load",
    ),
    ("2000 lists in a list", f"[constants]\n{LISTS}\n", "no TOML file", "load"),
    ("3900 signs", f'[model]\nx = "{"-" * 3900}v"\n', "model.x: expected an expression less deep", "load"),
    ("five lists of 100 lists", nested(5, 100), "expressions.e3: .*bytes for a value", "read"),
    ("five lists of 600 lists", nested(5, 600), "expressions.e2: .*bytes for a value", "read"),
    ("an index of 401 digits", f'[model]\nx = "v[{BIG}]"\n', "model.x: ", "read"),
]

# Entry, what is wrong, name of the file, its content, words.
TEXTS = [
    ("load", "a number of 401 digits", "f.toml", f"{FILTER}[{BIG}]", r"a\[0\]: expected a finite number"),
    ("load", "nan", "f.toml", f"{FILTER}[nan]", r"a\[0\]: expected a finite number"),
    ("load", "2000 lists in a list", "f.toml", LISTS, "no TOML file"),
    ("load", "a key of 5000 parts", "f.toml", "a." * 5000 + "b = 1", "at most 16 parts"),
    ("load", "600 kB", "f.toml", "# " + "a" * 600_000, "at most 500000 bytes"),
    ("live.restore", "20000 lists in a list", "a.json", BRACKETS, "in JSON"),
    ("load_session", "20000 lists in a list", "a.json", BRACKETS, "session: expected"),
    ("Checkpoint", "20000 lists in a list", "a.jsonl", BRACKETS + "\n", "line 1 is no JSON"),
    ("Checkpoint", "a line of another kind", "a.jsonl", ANSWERS, "expected job and answer"),
    ("read_parameters", "2000 lists in a list", "f.toml", LISTS, "no TOML file"),
    ("read_parameters", "a number for a table", "f.toml", "a = 3\n", "a: expected a table"),
    ("read_recipe", "2000 lists in a list", "recipe.toml", LISTS, "no TOML file"),
]
READERS: dict[str, Callable[[Path], object]] = {
    "load": pf.load,
    "live.restore": restored,
    "load_session": load_session,
    "Checkpoint": lambda path: Checkpoint(path, {}),
    "read_parameters": lambda path: read_parameters(path, Row),
    "read_recipe": lambda path: read_recipe(path.parent),
}

FMUS: dict[str, Callable[[Path], object]] = {
    "describe": describe,
    "check": check,
    "import_fmu": lambda path: import_fmu(path, kind="cs"),
    "cosimulate": lambda path: cosimulate({"a": path}, timepts=TIMES),
    "fmu describe": lambda path: command(["fmu", "describe", str(path)]),
    "fmu check": lambda path: command(["fmu", "check", str(path)]),
    "fmu run": lambda path: command(["fmu", "run", str(path)]),
}
# What is wrong, words, how it is made.
ARCHIVES = [
    ("an entry outside", "leads out", archive(("../evil.txt", "x"))),
    ("a link", "is a link", archive(link("resources/passwd", "/etc/passwd"))),
    ("4 MB of zeros", "times its size", archive(("resources/zeros", bytes(4 << 20)))),
]
DESCRIPTIONS = [
    ("a path as identifier", "modelIdentifier: expected a name", ELSEWHERE),
    ("a document type", "document type", archive(("modelDescription.xml", "<!DOCTYPE a><a/>"))),
    ("2e9 event indicators", "event indicators", fmu(INDICATORS.format(0), INDICATORS.format(2 * 10**9))),
]


def labelled(path: Path) -> object:
    """By the command that reads columns."""
    return command(["log", "label", str(path), "--x", "v", "--out", str(path.with_name("out.csv"))])


def hdf5_and_robot(path: Path) -> Path:
    robot_file('[model]\nx = "v"\n')(path.with_name("robot.toml"))
    return hdf5_matrix(path)


def estimated(path: Path) -> object:
    """By the command that reads logs through a robot file."""
    robot_path = str(path.with_name("robot.toml"))
    return command(["estimate", str(path), "--robot", robot_path, "--order", "1", "--largest", "1000"])


def cosimulated(path: Path) -> object:
    return cosimulate(path, timepts=TIMES)


def rows() -> list[Row]:
    """All of them."""
    big, longest = into("a.h5", hdf5), fmu(EXPERIMENT, 'stopTime="1e9" stepSize="1e-6"')
    found = [
        Row("open_log", "HDF5, 8 GB in 4 kB", "bytes of memory", big, pf.open_log, "h5py"),
        Row("open_log", "HDF5, a chunk of 2 GB", "a chunk", into("a.h5", hdf5_chunk), pf.open_log, "h5py"),
        Row("read_recording", "HDF5, 8 GB in 4 kB", "bytes of memory", big, read_recording, "h5py"),
        Row("log", "HDF5, 8 GB in 4 kB", "--largest", big, lambda p: command(["log", str(p)]), "h5py"),
        Row("estimate", "HDF5, a wide matrix", "--largest", into("a.h5", hdf5_and_robot), estimated, "h5py"),
        Row("log label", "HDF5, 8 GB in 4 kB", "--largest", big, labelled, "h5py"),
    ]
    found += [
        Row("open_log", wrong, words, into(name, make), opened, package)
        for wrong, name, make, words, package in LOGS
    ]
    line, from_csv = into("a.csv", csv_line), pf.Recording.from_csv
    found.append(Row("Recording.from_csv", "a line of 8 MB", "lines of at most", line, from_csv))
    found += [
        Row(
            f"Robot.{entry}",
            wrong,
            words,
            into("robot.toml", robot_file(content)),
            robot.Robot.load if entry == "load" else read_by_robot,
        )
        for wrong, content, words, entry in ROBOTS
    ]
    found += [
        Row(entry, wrong, words, into(name, text(content)), READERS[entry])
        for entry, wrong, name, content, words in TEXTS
    ]
    noise, shape = into("a.onnx", text(bytes(range(256)) * 8)), into("a.npz", npz_shape)
    found += [
        Row("learned_model", "packed arrays", "is compressed", into("a.npz", npz), learned_model),
        Row("learned_model", "a shape of 8 TB", "declares the shape", shape, learned_model),
        Row("OnnxNetwork.load", "a shape of 8 TB", "declares the shape", shape, OnnxNetwork.load),
        Row(
            "learned_model", "ONNX of random bytes", "not an ONNX model|damaged", noise, learned_model, "onnx"
        ),
    ]
    found += [
        Row(entry, wrong, words, into("a.fmu", make), enter)
        for entry, enter in FMUS.items()
        for wrong, words, make in [*ARCHIVES, *DESCRIPTIONS]
    ]
    found.append(Row("fmu run", "1e15 steps", "--max-steps", into("a.fmu", longest), FMUS["fmu run"]))
    inside = ("an FMU with a path", r"resources.a\.fmu: .*modelIdentifier", package(ELSEWHERE))
    found += [
        Row("cosimulate", f"SSP, {wrong}", words, into("a.ssp", make), cosimulated)
        for wrong, words, make in [inside, *ARCHIVES]
    ]
    return found


def main() -> int:
    """Print the table; 1 if a row does not say what it should."""
    from importlib.util import find_spec

    if sys.platform == "linux":
        import resource

        with Path("/proc/self/statm").open() as file:
            taken = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, taken + MEMORY))
    failed = 0
    for row in rows():
        if find_spec(row.package) is None:
            print(f"{row.entry:20} {row.wrong:42} not tried: {row.package} is not installed")
            continue
        with tempfile.TemporaryDirectory() as folder:
            try:
                words = said(row, Path(folder)).replace(folder, "...")
            except Exception as error:
                failed, words = 1, f"FAILED {type(error).__name__}: {error}"
        print(f"{row.entry:20} {row.wrong:42} {' '.join(words.split())[:160]}", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main())
