"""Exported folders: they build without a warning, run like the model, and are written all or not at all."""

import ctypes as ct
import os
import shlex
import subprocess
from pathlib import Path

import control
import numpy as np
import pytest
from flat_models import STRICT, by_hand, oscillator, two_rates

import phyfilter_ctl as pf
from phyfilter_ctl.codegen import find_compiler
from phyfilter_ctl.codegen.compiler import compile_sources
from phyfilter_ctl.codegen.diagram_folder import export_diagram
from phyfilter_ctl.codegen.diagram_source import diagram_model, runtime_sources
from phyfilter_ctl.codegen.export_folder import write_folder
from tests.cpu_budget import slow_but

# Some hundred steps of some ten operations each, in another order of summation.
ROUNDING = 1e-12
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1")

# What a program does with a model: runs in pieces, saves and restores, sets parameters, fails and goes on.
DRIVER = """\
#include <stdio.h>
#include <string.h>
#include "two_rates.h"
#include "pf_run.h"

int main(void) {
  static two_rates self, saved;
  pf_real work[64], u[1] = {0.5}, y[TWO_RATES_N_Y], slope[1] = {0.1}, s[TWO_RATES_N_S];
  pf_solver adaptive = {PF_ADAPTIVE, 0, (pf_real)1e-6, (pf_real)1e-6, 0, 0};
  pf_time t = 0, reached;
  if (sizeof work / sizeof *work < two_rates_pf_work_reals(&two_rates_model)) return 1;
  two_rates_init(&self);
  for (int k = 0; k < 300; k++)
    if (two_rates_step(&self, u, y)) return 2;
  two_rates_reset(&self);
  if (two_rates_model.start(&self, 0)) return 3;
  for (int k = 1; k < 200; k++) {
    const pf_time end = t + 1e-7 * (pf_time)(k * k % 97) * (pf_time)k;
    const pf_real *const rates = k % 2 ? slope : NULL;
    if (two_rates_pf_advance(&two_rates_model, &self, work, &adaptive, t, end, rates, &reached)) return 4;
    if (reached < end || end < reached) return 5;
    t = end;
    if (k == 100) memcpy(&saved, &self, sizeof self);
  }
  memcpy(&self, &saved, sizeof self);
  two_rates_parameters p = {0, 0, {(pf_real)9.0, (pf_real)0.1, 3}};
  if (!two_rates_set_parameters(&self, &p)) return 6; /* another version */
  two_rates_seal(&p);
  p.p[0] = 8;
  if (!two_rates_set_parameters(&self, &p)) return 7; /* damaged */
  two_rates_seal(&p);
  if (two_rates_set_parameters(&self, &p)) return 8;
  p.p[1] = (pf_real)0 / (pf_real)(p.p[0] - 8);
  two_rates_seal(&p);
  if (!two_rates_set_parameters(&self, &p)) return 9; /* not a number */
  two_rates_reset(&self);
  if (two_rates_model.p(&self)[0] < 8 || two_rates_model.p(&self)[0] > 8) return 10; /* kept */
  two_rates_model.s(&self, s);
  two_rates_set_states(&self, s);
  const two_rates before = self;
  u[0] = (pf_real)0 / (pf_real)(s[0] - s[0]);
  if (two_rates_step(&self, u, y) != PF_NOT_FINITE) return 11;
  if (memcmp(&before, &self, sizeof self)) return 12;
  u[0] = 1;
  if (two_rates_step(&self, u, y)) return 13;
  printf("done\\n");
  return 0;
}
"""


@pytest.fixture(scope="module", params=slow_but(["double"], ["double", "float"]))
def exported(request, tmp_path_factory):
    parent = tmp_path_factory.mktemp(request.param)
    return export_diagram(two_rates(), parent / "code", real=request.param), request.param


def test_the_build_line_in_the_example_works_as_written(exported):
    folder, _ = exported
    line = next(line for line in (folder / "main.c").read_text().splitlines() if "Build all files" in line)
    command = line.split(":", 1)[1].strip().replace("cc ", shlex.join(find_compiler().command) + " ", 1)
    subprocess.run(f"{command} {' '.join(STRICT)}", shell=True, cwd=folder, check=True)
    run = subprocess.run(["./two_rates"], cwd=folder, check=True, capture_output=True, text=True)
    (folder / "two_rates").unlink()
    last = [float(word) for word in run.stdout.splitlines()[-1].split()]
    assert last[0] == 1.0
    outputs, _, _ = by_hand(two_rates(), 0.001 * np.arange(1001), np.zeros((1001, 1)))
    tolerance = 1e-8 if exported[1] == "double" else 1e-3  # nine digits; rounding to float over 1000 steps
    np.testing.assert_allclose(last[1:], outputs[-1], rtol=tolerance, atol=tolerance)


def test_step_is_the_loop_by_hand(tmp_path):
    """One call per 1 ms, the common divisor of 2 and 3 ms."""
    model = diagram_model(two_rates())
    library = ct.CDLL(
        str(compile_sources(model.sources, tmp_path / "a.so", flags=["-fvisibility=default", *STRICT]))
    )
    memory = (ct.c_char * 4096)()
    library.two_rates_init(memory)
    rng = np.random.default_rng(6)
    u = rng.normal(size=(120, 1))
    y = np.empty((120, 3))
    for k in range(120):
        assert (
            library.two_rates_step(memory, ct.c_void_p(u[k].ctypes.data), ct.c_void_p(y[k].ctypes.data)) == 0
        )
    outputs, _, _ = by_hand(two_rates(), 0.001 * np.arange(120), u)
    np.testing.assert_allclose(y, outputs, atol=ROUNDING)


@pytest.mark.parametrize(
    ("periods", "step", "defined"),
    [
        ((0.003, 0.002), None, "0.001"),
        ((0.01, 0.005), None, "0.005"),
        ((1 / 3, 0.5), None, "0.1666"),
        ((0.1, 0.1), 0.025, "0.025"),
    ],
)
def test_base_step_meets_all_instants(periods, step, defined):
    text = diagram_model(two_rates(*periods), step=step).sources["two_rates.h"]
    assert f"#define TWO_RATES_STEP {defined}" in text


@pytest.mark.slow
def test_sanitizers_find_nothing(exported, tmp_path):
    folder, _ = exported
    sources = {path.name: path.read_text() for path in folder.iterdir() if path.suffix in {".c", ".h"}}
    sources["main.c"] = DRIVER
    program = compile_sources(sources, tmp_path / "driver", kind="program", flags=[*STRICT, *SANITIZERS])
    run = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout) == (0, "done\n"), run.stderr


@pytest.mark.parametrize("real", ["double", "float"])
def test_the_runtime_converts_nothing_silently(real, tmp_path):
    sources = runtime_sources(
        ("pf_ieee.h", "pf_model.h", "pf_run.h", "pf_run.c", "pf_simulate.h", "pf_simulate.c"), real
    )
    sources |= runtime_sources(("pf_instants.h", "pf_crc.h"), real)
    sources["all.c"] = '#include "pf_instants.h"\n#include "pf_crc.h"\nint pf_all;\n'
    compile_sources(sources, tmp_path / "a.so", flags=[*STRICT, "-Wconversion"])


def test_no_file_is_left_out_or_left_over(tmp_path):
    folder = export_diagram(two_rates(), tmp_path / "code")
    first = {path.name for path in folder.iterdir()}
    assert {"two_rates.h", "two_rates.c", "main.c", "pf_run.c", "pf_files.txt"} <= first
    export_diagram(oscillator(), folder)
    second = {path.name for path in folder.iterdir()}
    assert "oscillator.c" in second
    assert "two_rates.c" not in second
    assert [path.name for path in tmp_path.iterdir()] == ["code"]


def test_files_of_others_are_not_overwritten(tmp_path):
    folder = tmp_path / "code"
    export_diagram(oscillator(), folder)
    (folder / "mine.c").write_text("int mine;")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(FileExistsError, match=r"holds files that no export wrote \(mine\.c\)"):
        export_diagram(two_rates(), folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    plain = tmp_path / "file"
    plain.write_text("")
    with pytest.raises(FileExistsError, match="is a file"):
        export_diagram(oscillator(), plain)
    with pytest.raises(FileNotFoundError, match="no such folder to export into"):
        export_diagram(oscillator(), tmp_path / "a" / "b")
    with pytest.raises(ValueError, match="paths within the folder"):
        write_folder(tmp_path / "c", {"../d": ""})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["code", "file"]


def test_a_write_that_fails_leaves_the_old_export(tmp_path, monkeypatch):
    folder = export_diagram(oscillator(), tmp_path / "code")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def full(self, *args, **kwargs):
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="disk full"):
        export_diagram(two_rates(), folder)
    monkeypatch.undo()
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert os.listdir(tmp_path) == ["code"]


def test_two_exports_are_the_same_bytes(tmp_path):
    one, other = export_diagram(two_rates(), tmp_path / "a"), export_diagram(two_rates(), tmp_path / "b")
    for path in one.iterdir():
        assert path.read_bytes() == (other / path.name).read_bytes()


@pytest.mark.slow
def test_a_diagram_with_a_filter_is_exported_in_float(tmp_path):
    block = pf.sampled_block(pf.PhyFilter([20.0]).sampled(0.01), 1)
    loop = control.interconnect([block], inputs=block.input_labels, outputs=block.output_labels, name="loop")
    folder = pf.export_c(loop, tmp_path / "loop", real="float")
    sources = {path.name: path.read_text() for path in folder.iterdir() if path.suffix in (".c", ".h")}
    sources = {name: text for name, text in sources.items() if "main(" not in text}
    compile_sources(sources, tmp_path / "a.so", flags=STRICT)
