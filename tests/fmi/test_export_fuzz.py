"""Random calls into exported FMUs under the address and undefined-behaviour sanitizers.

    python tests/fmi/test_export_fuzz.py [SEQUENCES]

runs more than the tests do: 100,000 sequences of 40 calls for each model and version.
"""

import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import control as ct
import pytest
from exported_fmus import SYSTEMS

import phyfilter_ctl as pf
from phyfilter_ctl.codegen import CompilerError, compile_sources
from phyfilter_ctl.fmi.description import FmuSolver, fmu_interface
from phyfilter_ctl.fmi.export import _c_model
from phyfilter_ctl.fmi.glue import fmi_headers, fmu_sources

HERE = Path(__file__).parent / "fuzz"
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1", "-std=gnu99")
SEQUENCES = 3_000
CASES = [
    ("sampled", "2.0"),
    ("sampled", "3.0"),
    ("loop", "3.0"),
    ("continuous", "2.0"),
    ("fixed", "3.0"),
    ("loop", "2.0"),
]


@cache
def sanitizers_work():
    source = {"a.c": "int main(void) { return 0; }"}
    with tempfile.TemporaryDirectory() as folder:
        try:
            program = compile_sources(source, Path(folder, "a"), kind="program", flags=SANITIZERS)
        except CompilerError:
            return False
        return subprocess.run([program], check=False).returncode == 0


def fuzzer(name, fmi, folder):
    system, options = SYSTEMS[name]()
    if isinstance(system, ct.InputOutputSystem):
        system = pf.flatten(system)
    model, _ = _c_model(
        system, "fuzzed", options.get("channels"), None, options.get("rate", "communication"), None
    )
    # Long steps are legal; few pieces keep them short.
    interface = fmu_interface(model, fmi=fmi, solver=FmuSolver("rk4", 0.005))
    sources = {**fmi_headers(fmi), **fmu_sources(interface, "fuzz"), "fuzz.h": (HERE / "fuzz.h").read_text()}
    file = f"fuzz{fmi[0]}.c"
    sources[file] = (HERE / file).read_text()
    return compile_sources(
        sources, Path(folder, f"{name}{fmi[0]}"), kind="program", name=name, flags=SANITIZERS
    )


def run(program, sequences, seed):
    return subprocess.run([program, str(sequences), str(seed)], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(("name", "fmi"), CASES)
def test_random_calls(tmp_path, name, fmi):
    if not sanitizers_work():
        pytest.skip("the C compiler has no sanitizers: random calls are not tried")
    answer = run(fuzzer(name, fmi, tmp_path), SEQUENCES, 1)
    assert answer.returncode == 0, answer.stderr[-3000:]
    refused = int(answer.stdout.split()[2])
    assert refused > 5 * SEQUENCES  # it does try what is not allowed


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        for name in SYSTEMS:
            for fmi in ("2.0", "3.0"):
                answer = run(fuzzer(name, fmi, folder), count, 1)
                failed |= answer.returncode != 0
                print(f"{name} FMI {fmi}: {answer.stdout.strip() or answer.stderr[-2000:]}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
