"""Random calls into exported FMUs under the address and undefined-behaviour sanitizers: sequences of 40 calls."""

import subprocess
import tempfile
from functools import cache
from itertools import product
from pathlib import Path

import control as ct
import pytest
from exported_fmus import FOLDER, SYSTEMS
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

import phyfilter_ctl as pf
from phyfilter_ctl.codegen import CompilerError
from phyfilter_ctl.codegen.compiler import compile_sources
from phyfilter_ctl.fmi import FmuPorts
from phyfilter_ctl.fmi.channels import with_channels
from phyfilter_ctl.fmi.description import FmuExperiment, FmuSolver, fmu_interface
from phyfilter_ctl.fmi.export import _c_model
from phyfilter_ctl.fmi.glue import fmi_headers, fmu_sources
from tests.cpu_budget import release_but

HERE = Path(__file__).parent / "fuzz"
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1", "-std=gnu99")
SEQUENCES = 3_000
CASES = release_but(
    {("continuous", "2.0"), ("loop", "3.0"), ("channels", "3.0")},
    [*product(SYSTEMS, ("2.0", "3.0")), ("clocks", "3.0"), ("channels", "3.0")],
)


@cache
def sanitizers_work():
    source = {"a.c": "int main(void) { return 0; }"}
    with tempfile.TemporaryDirectory() as folder:
        try:
            program = compile_sources(source, Path(folder, "a"), kind="program", flags=SANITIZERS)
        except CompilerError:
            return False
        return subprocess.run([program], check=False).returncode == 0


@cache
def fuzzer(name, fmi):
    system, options = SYSTEMS[{"clocks": "loop", "channels": "continuous"}.get(name, name)]()
    if isinstance(system, ct.InputOutputSystem) and not isinstance(system, pf.PhyFilter):
        system = pf.flatten(system)
    channels = (
        system.sampling.n_x
        if isinstance(system, pf.SampledPhyFilter)
        else options.get("ports", FmuPorts()).channels
    )
    model, _ = _c_model(system, "fuzzed", channels, None, options.get("rate", "communication"), (), None)
    # Long steps are legal; few pieces keep them short.
    interface = fmu_interface(
        model, fmi=fmi, experiment=FmuExperiment(solver=FmuSolver("rk4", 0.005)), clocks=name == "clocks"
    )
    if name == "channels":  # room for 2
        interface = with_channels(interface, 1)
    sources = {**fmi_headers(fmi), **fmu_sources(interface, "fuzz"), "fuzz.h": (HERE / "fuzz.h").read_text()}
    file = f"fuzz{fmi[0]}.c"
    sources[file] = (HERE / file).read_text()
    return compile_sources(
        sources, FOLDER / f"fuzz_{name}{fmi[0]}", kind="program", name=name, flags=SANITIZERS
    )


@pytest.mark.parametrize(("name", "fmi"), CASES)
@settings(max_examples=1, phases=[Phase.generate])  # a smaller seed is no simpler
@given(seed=st.integers(0, 2**32))
def test_random_calls(name, fmi, seed):
    if not sanitizers_work():
        pytest.skip("the C compiler has no sanitizers: random calls are not tried")
    command = [fuzzer(name, fmi), str(SEQUENCES), str(seed)]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr[-3000:]
    refused = int(answer.stdout.split()[2])
    assert refused > 5 * SEQUENCES  # it does try what is not allowed
