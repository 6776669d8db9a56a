"""Hostile FMUs: damaged and malicious archives, descriptions and binaries, and what they do to who opens them.

    python benchmarks/hostile_fmus.py [--quick] [--archives N] [--binaries N] [--seed S] [--json FILE]

Archives: real ones of FMI 2.0 and 3.0 and of SSP with bytes of the archive or of the description changed, cut off, or
given hostile values, names, sizes, links, bombs and document types; their sources and binaries are cut short. Each FMU
is described and checked without running it, each package read, all of them unpacked, in a folder in memory.
Binaries: a real one with bytes changed, imported and stepped in a process of its own.
Promises: every archive is taken or refused by ValueError, within 5 s and 1 GiB, and no file appears outside its folder;
every binary runs or ends in FmuError, within its limit. Needs a POSIX system (limits of memory and time).
"""

from __future__ import annotations

import argparse
import io
import json
import random
import re
import resource
import shutil
import signal
import stat
import sys
import tempfile
import time
import zipfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import control as ct
from tqdm import tqdm

from phyfilter_ctl.fmi import (
    Fmu,
    FmuError,
    Isolation,
    System,
    check,
    describe,
    export_fmu,
    import_fmu,
    read_ssp,
    write_ssp,
)
from phyfilter_ctl.fmi.archive import unpack
from phyfilter_ctl.fmi.cosimulation_wiring import Wire

MOST_SECONDS, MOST_BYTES = 5.0, 1 << 30
LIMIT = Isolation(call_limit=2.0, run_limit=4.0)
CHUNK = 50
SHORT = 64
MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
VALUES = [
    *(
        "",
        "-1",
        "0",
        "1e999",
        "NaN",
        "-INF",
        "4294967296",
        "99999999999999999999",
        "1 2 3",
        "true",
        "\u0663",
        "%s%n",
    ),
    *("../../outside", "/etc/passwd", "x" * 100_000, "a[999999999]", "${jndi}", "\u202e", "1000000000"),
]
NAMES = [
    *(
        "../outside.txt",
        "/tmp/outside.txt",
        "C:/outside.txt",
        "a\\..\\..\\outside.txt",
        "resources/../../outside.txt",
    ),
    *(
        "resources//x",
        "CON",
        "a" * 5000,
        "\u202egnp.exe",
        "MODELDESCRIPTION.XML",
        "modelDescription.xml/x",
        "a\nb",
    ),
]
DOCTYPES = [
    '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>',
    '<!DOCTYPE x SYSTEM "file:///etc/passwd">',
]
DESCRIPTIONS = ("modelDescription.xml", "SystemStructure.ssd")
Entries = list[tuple[zipfile.ZipInfo, bytes]]


def changed_bytes(data: bytes, chance: random.Random) -> bytes:
    result = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 8, 64))):
        at = chance.randrange(len(result))
        result[at] = chance.choice((chance.randrange(256), 0, 255, result[at] ^ (1 << chance.randrange(8))))
    return bytes(result)


def changed_text(data: bytes, chance: random.Random) -> bytes:
    """A description with one thing wrong in it."""
    text = data.decode()
    values = list(re.finditer(r'"([^"]*)"', text))
    elements = list(re.finditer(r"<(\w+)[^<>]*/>", text))
    match chance.randrange(7):
        case 0 | 1 | 2:
            spot = chance.choice(values)
            return (text[: spot.start(1)] + chance.choice(VALUES) + text[spot.end(1) :]).encode()
        case 3:
            spot = chance.choice(elements)
            copies = "" if chance.random() < 0.5 else spot[0] * chance.choice((2, 1000))
            return (text[: spot.start()] + copies + text[spot.end() :]).encode()
        case 4:
            sizes = "".join(
                f'<Dimension start="{chance.choice((0, 3, 10**5, 10**9, 2**63))}"/>' for _ in range(3)
            )
            return text.replace('causality="output"/>', f'causality="output">{sizes}</Float64>').encode()
        case 5:
            return text.replace("?>", f"?>{chance.choice(DOCTYPES)}", 1).encode()
        case _:
            depth = chance.choice((10, 300, 100_000))
            return text.replace(
                "</ModelVariables>", "<a>" * depth + "</a>" * depth + "</ModelVariables>"
            ).encode()


def changed_entries(entries: Entries, chance: random.Random) -> Entries:
    """An archive with an entry too many."""
    extra = zipfile.ZipInfo(chance.choice(NAMES))
    content = b"outside"
    match chance.randrange(4):
        case 0:
            extra = zipfile.ZipInfo("resources/link")
            extra.external_attr = (chance.choice((stat.S_IFLNK, stat.S_IFCHR, stat.S_IFIFO)) | 0o777) << 16
            content = b"/etc/passwd"
        case 1:
            extra = zipfile.ZipInfo("resources/zeros")
            extra.compress_type = zipfile.ZIP_DEFLATED
            content = bytes(chance.choice((1 << 10, 8 << 20)))
        case 2:
            extra = zipfile.ZipInfo(chance.choice(entries)[0].filename)
    return [*entries, (extra, content)]


def hostile(seed: int, bases: list[bytes]) -> bytes:
    """The archive of a seed."""
    chance = random.Random(seed)
    base = chance.choice(bases)
    way = chance.randrange(5)
    if way == 0:
        return changed_bytes(base, chance)
    if way == 1:
        return base[: chance.randrange(len(base))] + base[: chance.randrange(50) * chance.randrange(2)]
    with zipfile.ZipFile(io.BytesIO(base)) as source:
        entries: Entries = [(info, source.read(info)) for info in source.infolist()]
    if way == 2:
        entries = changed_entries(entries, chance)
    else:
        change = changed_text if way == 3 else changed_bytes
        entries = [
            (info, change(data, chance) if info.filename in DESCRIPTIONS else data) for info, data in entries
        ]
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for info, data in entries:
            archive.writestr(info, data, None if way != 2 else info.compress_type)
    return target.getvalue()


def short(data: bytes) -> bytes:
    """The archive with little in the files that nobody reads here."""
    target = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(data)) as source,
        zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for info in source.infolist():
            content = source.read(info)
            if info.filename.endswith(".fmu"):
                content = short(content)
            elif not info.filename.endswith((".xml", ".ssd", ".ssv", ".ssm", ".ssb")):
                content = content[:SHORT]
            archive.writestr(info, content)
    return target.getvalue()


def opened(path: Path, folder: Path) -> str:
    """What comes of an archive: "taken", or "refused", of one of which nothing is left behind."""
    try:
        unpack(path, folder)
    except ValueError:
        shutil.rmtree(folder)
        folder.mkdir()
    try:
        with zipfile.ZipFile(path) as archive:
            package = "SystemStructure.ssd" in archive.namelist()
    except Exception:  # the standard library may well stumble here
        package = False
    try:
        if package:
            str(read_ssp(path))
        else:
            report = check(path, run=False)
            str(report)
            if not report.errors or len(report.stages) > 1:
                str(describe(path))
            else:
                return "refused"
    except ValueError:
        return "refused"
    return "taken"


def tried(bases: list[bytes], seeds: list[int]) -> tuple[Counter[str], list[str], float]:
    """Outcomes, what was promised and not kept, longest time; in a process with limits."""
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    outcomes: Counter[str] = Counter()
    broken: list[str] = []
    longest = 0.0
    for seed in seeds:
        with tempfile.TemporaryDirectory(dir=MEMORY, ignore_cleanup_errors=True) as sandbox:
            tempfile.tempdir = sandbox
            inside, path = Path(sandbox, "inside"), Path(sandbox, "hostile.fmu")
            inside.mkdir()
            path.write_bytes(hostile(seed, bases))
            began = time.perf_counter()
            signal.setitimer(signal.ITIMER_REAL, MOST_SECONDS)
            signal.setitimer(
                signal.ITIMER_VIRTUAL, 4.0 * MOST_SECONDS
            )  # ends the process, where Python is not asked
            try:
                outcomes[opened(path, inside)] += 1
            except BaseException as error:  # whatever it is: the promise is one kind of refusal
                broken.append(f"seed {seed}: {type(error).__name__}: {str(error)[:120]}")
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
                tempfile.tempdir = None
            longest = max(longest, time.perf_counter() - began)
            strays = {entry.name for entry in Path(sandbox).iterdir()} - {"inside", "hostile.fmu"}
            links = [entry.name for entry in inside.rglob("*") if entry.is_symlink()]
            if strays or links or Path(sandbox).parent.joinpath("outside.txt").exists():
                broken.append(f"seed {seed}: left {strays or links or 'outside.txt'}")
    return outcomes, broken, longest


def archives(bases: list[bytes], seeds: range, broken: list[str]) -> tuple[Counter[str], float]:
    outcomes: Counter[str] = Counter()
    longest = 0.0
    chunks = [list(seeds[k : k + CHUNK]) for k in range(0, len(seeds), CHUNK)]
    done = 0
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        try:
            answers = pool.map(partial(tried, bases), chunks)
            for found, faults, slowest in tqdm(answers, total=len(chunks), disable=None):
                outcomes += found
                broken += faults
                longest = max(longest, slowest)
                done += CHUNK
        except BrokenProcessPool:
            broken.append(f"the process died or hung between seeds {seeds[done]} and {seeds[done] + CHUNK}")
    return outcomes, longest


def binaries(base: bytes, seeds: range, broken: list[str]) -> tuple[Counter[str], float]:
    """Bytes of the binary changed: it may crash, hang or lie in its own process."""
    outcomes: Counter[str] = Counter()
    longest = 0.0
    for seed in tqdm(seeds, disable=None):
        chance = random.Random(seed)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "hostile.fmu")
            with zipfile.ZipFile(io.BytesIO(base)) as source, zipfile.ZipFile(path, "w") as target:
                for info in source.infolist():
                    data = source.read(info)
                    if info.filename.startswith("binaries") and not info.is_dir():
                        for _ in range(chance.choice((1, 3, 20))):
                            data = changed_bytes(data, chance)
                    target.writestr(info, data)
            began = time.perf_counter()
            try:
                block = import_fmu(Fmu(path, isolated=LIMIT), kind="cs", step=0.01)
                for _ in range(5):
                    block.step([1.0] * (block.ninputs or 0))  # pyright: ignore[reportAttributeAccessIssue]
                block.close()
                outcomes["ran"] += 1
            except FmuError as error:
                outcomes[error.status] += 1
            except BaseException as error:  # whatever it is: the promise is one kind of error
                broken.append(f"binary {seed}: {type(error).__name__}: {str(error)[:120]}")
            longest = max(longest, time.perf_counter() - began)
    return outcomes, longest


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="50 archives, 1 binary")
    parser.add_argument("--archives", type=int, default=100_000)
    parser.add_argument("--binaries", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the first one")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    counts = (50, 1) if options.quick else (options.archives, options.binaries)
    lag = ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs="u", outputs="y", name="lag")
    with tempfile.TemporaryDirectory() as folder:
        paths = [
            export_fmu(lag, Path(folder, f"lag{fmi}.fmu"), fmi=fmi, name="lag") for fmi in ("2.0", "3.0")
        ]
        whole = paths[1].read_bytes()
        wires = [Wire("second.u", "first.y")]
        paths.append(
            write_ssp(System({"first": paths[0], "second": paths[1]}, wires), Path(folder, "lags.ssp"))
        )
        bases = [short(path.read_bytes()) for path in paths]
    broken: list[str] = []
    table = {
        "archives": archives(bases, range(options.seed, options.seed + counts[0]), broken),
        "binaries": binaries(whole, range(options.seed, options.seed + counts[1]), broken),
    }
    for name, (outcomes, longest) in table.items():
        words = ", ".join(f"{count} {word}" for word, count in sorted(outcomes.items()))
        print(f"{sum(outcomes.values()):7} {name}: {words}; the longest took {longest:.2f} s")
    for fault in broken[:20]:
        print(f"        {fault}")
    print("the promises hold" if not broken else f"{len(broken)} PROMISES DO NOT HOLD")
    if options.json:
        answers = {name: {**outcomes, "longest": longest} for name, (outcomes, longest) in table.items()}
        options.json.write_text(json.dumps(answers | {"broken": broken}, indent=1))
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
