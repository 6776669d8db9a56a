"""Stack of a package's functions on a Cortex-M4F: the deepest path of gcc's own call graph, no more than is said."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, SampledPhyFilter, export_target
from phyfilter_ctl.codegen.filter_guard import guard_stack

GCC = "arm-none-eabi-gcc"
FLAGS = [
    "-mcpu=cortex-m4",
    "-mthumb",
    "-mfloat-abi=hard",
    "-mfpu=fpv4-sp-d16",
    "-std=c99",
    "-fcallgraph-info=su",
]
# Beyond the files of the package: of these the bound has 64 bytes.
LIBRARY = re.compile(r"mem(cpy|set|cmp|move)|__aeabi_\w+")


def deepest(graphs):
    """Bytes from each function on, along its deepest path of calls."""
    sizes, calls, outside = {}, {}, set()
    for line in "".join(graph.read_text() for graph in graphs).splitlines():
        if node := re.match(r'node: { title: "([^"]+)" label: "[^"]*?(\d+) bytes \((\w+)\)', line):
            assert node[3] == "static"
            sizes[node[1]] = int(node[2])
        elif node := re.match(r'node: { title: "([^"]+)"', line):
            outside.add(node[1])
        elif edge := re.match(r'edge: { sourcename: "([^"]+)" targetname: "([^"]+)"', line):
            calls.setdefault(edge[1], set()).add(edge[2])
    assert all(LIBRARY.fullmatch(name) for name in outside - set(sizes)), outside - set(sizes)

    def depth(name, above=()):
        assert name not in above, "a function that calls itself"
        return sizes.get(name, 0) + max(
            (depth(other, (*above, name)) for other in calls.get(name, ())), default=0
        )

    return {name: depth(name) for name in sizes}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("order", "optimise", "real", "options"),
    [
        (3, "-Os", "float", {}),
        (3, "-O3", "double", {"channels": 6, "inertia": "full"}),
        (6, "-O3", "float", {"filters": 3}),
        (12, "-O3", "double", {}),
    ],
)
def test_no_call_of_a_package_takes_more_stack_than_it_says(order, optimise, real, options, tmp_path):
    if shutil.which(GCC) is None:
        pytest.skip(f"{GCC} is not installed")
    pairs = 12.0 * np.exp(1j * np.linspace(2.2, 2.8, order // 2))
    filter_ = PhyFilter.from_poles([-12.0] * (order % 2) + [*pairs, *pairs.conj()]).sampled(0.002)
    filters, channels = options.get("filters", 1), options.get("channels", 3)
    filter_ = SampledPhyFilter(filter_.filters * filters, filter_.sampling)
    folder = export_target(
        filter_,
        "cmake",
        tmp_path / "wing",
        name="wing",
        real=real,
        channels=channels,
        inertia=options.get("inertia"),
    )
    ran = subprocess.run(
        [GCC, *FLAGS, optimise, "-c", *sorted((folder / "src").glob("*.c"))], cwd=tmp_path, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr[:2000]
    deep = deepest(tmp_path.glob("*.ci"))
    step = deep["wing_guard_step"]
    said = guard_stack(
        order, filters=filters, channels=channels, inertia=channels**2 if "inertia" in options else 0
    )
    print(
        f"order {order}, {real}, {channels} channels, {filters} filters, {optimise}: {step} bytes, {said} said"
    )
    assert max(deep.values()) == step <= said - 64
    assert f"at most {said:,} bytes" in (folder / "src" / "wing_guard.h").read_text()
    assert f"{said:,} bytes of stack" in (folder / "README.md").read_text()
