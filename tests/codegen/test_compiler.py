"""Finding the C compiler, running it, and the cache of what it made."""

import os
import stat
import sys
import threading
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from flat_models import oscillator

from phyfilter_ctl.codegen import CompilerError, compile_model, find_compiler
from phyfilter_ctl.codegen.compiler import cached_library, compile_sources, forget_oldest

PROGRAM = {"main.c": '#include "n.h"\nint main(void) { return N; }\n', "n.h": "#define N 7\n"}


def script(folder, name, text):
    path = folder / name
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def test_argument_before_environment_before_path(tmp_path, monkeypatch):
    one = script(tmp_path, "one", "echo one 1.0")
    two = script(tmp_path, "two", "echo two 2.0")
    monkeypatch.setenv("CC", f"{two} -m64")
    assert find_compiler(one).version == "one 1.0"
    assert find_compiler(f"{one} -m32").command == (str(one), "-m32")
    assert find_compiler().command == (str(two), "-m64")
    monkeypatch.delenv("CC")
    script(tmp_path, "gcc", "echo three")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_compiler().command == ("gcc",)


def test_a_path_with_a_blank_is_one_word(tmp_path):
    folder = tmp_path / "my tools"
    folder.mkdir()
    assert find_compiler(str(script(folder, "cc", "echo blank"))).version == "blank"


def test_a_missing_compiler_says_what_was_tried(tmp_path, monkeypatch):
    with pytest.raises(CompilerError, match="C compiler 'no-such-cc' not found"):
        find_compiler("no-such-cc")
    monkeypatch.setenv("CC", "no-such-cc")
    with pytest.raises(CompilerError, match=r"\(\$CC\) not found"):
        compile_sources(PROGRAM, tmp_path / "a")
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("phyfilter_ctl.codegen.compiler.find_spec", lambda name: None)
    with pytest.raises(CompilerError, match=r"tried \$CC, cc, gcc, clang and ziglang; install"):
        compile_model(oscillator())


def test_a_compiler_that_fails_is_quoted_with_the_models_name(tmp_path):
    broken = script(
        tmp_path,
        "cc",
        '[ "$1" = --version ] && echo broken && exit\n'
        "i=0; while [ $i -lt 40 ]; do i=$((i + 1)); echo line $i >&2; done; exit 1",
    )
    with pytest.raises(CompilerError, match=r"oscillator: .*cc \(broken\) failed:\nline 1\n") as caught:
        compile_model(oscillator(), compiler=broken)
    assert "line 12\n... and 28 lines more" in str(caught.value)
    with pytest.raises(CompilerError, match="fails on --version"):
        find_compiler(script(tmp_path, "dead", "exit 3"))
    (tmp_path / "binary").write_bytes(b"\x7fELF no program")
    (tmp_path / "binary").chmod(0o755)
    with pytest.raises(CompilerError, match="does not run"):
        find_compiler(tmp_path / "binary")


def test_an_error_in_the_sources_leaves_nothing_behind(tmp_path):
    with pytest.raises(CompilerError, match=r"wing: .*failed:(.|\n)*main\.c"):
        compile_sources(
            {"main.c": "int main(void) { return x; }"}, tmp_path / "a", kind="program", name="wing"
        )
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match=r"at least one \.c file"):
        compile_sources({"a.h": ""}, tmp_path / "a")
    with pytest.raises(ValueError, match="plain file names"):
        compile_sources({"../a.c": ""}, tmp_path / "a")


def test_a_program_runs(tmp_path):
    path = compile_sources(PROGRAM, tmp_path / "seven", kind="program")
    assert os.waitstatus_to_exitcode(os.system(str(path))) == 7


def test_only_what_is_marked_leaves_a_library():
    compiled = compile_model(oscillator())
    handle = compiled.library._handle
    assert hasattr(handle, "pf_exported_model")
    assert not hasattr(handle, "pf_advance")
    assert not hasattr(handle, "oscillator_model")


def test_cache_is_private_and_keyed_by_content(tmp_path, monkeypatch):
    monkeypatch.setenv("PHYFILTER_CTL_CACHE", str(tmp_path / "cache"))
    text = {"a.c": "int a(void); int a(void) { return 1; }"}
    first = cached_library(text)
    assert first.parent == tmp_path / "cache"
    assert stat.S_IMODE(first.parent.stat().st_mode) == 0o700
    made = first.stat().st_mtime_ns
    os.utime(first, ns=(made - 10**9, made - 10**9))
    assert cached_library(text) == first
    assert cached_library(text, flags=("-O1",)) != first
    assert cached_library({"a.c": text["a.c"] + "\n"}) != first
    assert len(list(first.parent.iterdir())) == 3


def test_a_cache_that_others_can_write_to_is_not_used(tmp_path, monkeypatch):
    if sys.platform == "win32":
        pytest.skip("Windows keeps no such bits")
    open_folder = tmp_path / "open"
    open_folder.mkdir()
    open_folder.chmod(0o777)
    monkeypatch.setenv("PHYFILTER_CTL_CACHE", str(open_folder))
    library = cached_library({"a.c": "int a(void); int a(void) { return 2; }"})
    assert library.parent != open_folder
    assert list(open_folder.iterdir()) == []
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PHYFILTER_CTL_CACHE", str(tmp_path / "file"))
    assert cached_library({"a.c": "int a(void); int a(void) { return 2; }"}) == library


def test_threads_that_compile_the_same_get_the_same(tmp_path, monkeypatch):
    find_compiler()  # skipped where there is none
    monkeypatch.setenv("PHYFILTER_CTL_CACHE", str(tmp_path))
    found: list[Path] = []
    text = {"a.c": "int a(void); int a(void) { return 3; }"}
    threads = [threading.Thread(target=lambda: found.append(cached_library(text))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    assert len({*found, *tmp_path.iterdir()}) == 1


def test_the_oldest_are_forgotten(tmp_path, monkeypatch):
    monkeypatch.setenv("PHYFILTER_CTL_CACHE", str(tmp_path))
    monkeypatch.setattr("phyfilter_ctl.codegen.compiler._KEPT_LIBRARIES", 3)
    for i in range(5):
        old = tmp_path / f"{i}.so"
        old.write_text("")
        os.utime(old, (1e9 + i, 1e9 + i))
    new = cached_library({"a.c": "int a(void); int a(void) { return 4; }"})
    assert {path.name for path in tmp_path.iterdir()} == {"3.so", "4.so", new.name}


def test_ziglang_is_found_where_nothing_else_is(tmp_path, monkeypatch):
    if find_spec("ziglang") is None:
        pytest.skip("ziglang is not installed")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_compiler().command == (sys.executable, "-m", "ziglang", "cc")


def test_a_library_outlives_its_file(tmp_path, monkeypatch):
    monkeypatch.setenv("PHYFILTER_CTL_CACHE", str(tmp_path))
    compiled = compile_model(oscillator())
    compiled.path.unlink()
    run = compiled.simulate([0.0, 1.0], max_step=0.01)
    np.testing.assert_allclose(run.outputs[-1], np.cos(2.0), atol=1e-7)


def test_cache_forgets_what_was_used_longest_ago_beyond_its_size(tmp_path, monkeypatch):
    monkeypatch.setattr("phyfilter_ctl.codegen.compiler._KEPT_BYTES", 250)
    for age, name in enumerate("abcde"):
        path = tmp_path / f"{name}.so"
        path.write_bytes(b"x" * (400 if name == "e" else 100))
        os.utime(path, (1e9 - age, 1e9 - age))
    forget_oldest(tmp_path)
    assert sorted(path.stem for path in tmp_path.iterdir()) == ["a", "b"]
    monkeypatch.setattr("phyfilter_ctl.codegen.compiler._KEPT_BYTES", 50)
    forget_oldest(tmp_path)
    assert [path.stem for path in tmp_path.iterdir()] == ["a"]  # the newest one is in use
