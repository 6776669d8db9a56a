"""Child of test_cosimulation_threads.py: the loop in C under ThreadSanitizer, as it is and with a race put in."""

import sys

import numpy as np

from phyfilter_ctl.fmi import Master, System, cosimulate, master

WIRES = [("a.place", "d.x"), ("b.place", "a.x"), ("c.place", "b.x"), ("d.place", "c.x")]
compile_as_usual = master.cached_library


def run(parts, change, **options):
    def sanitized(texts, *, name, flags):
        texts = {file: change(text) for file, text in texts.items()}
        return compile_as_usual(texts, name=name, flags=[*flags, "-fsanitize=thread", "-g"])

    master._library.cache_clear()
    master.cached_library = sanitized
    found = cosimulate(System(parts, WIRES), np.linspace(0.0, 0.3, 4), master=Master(0.001, **options))
    assert found.master == "C"
    return found.outputs


if __name__ == "__main__":
    parts = dict(zip("abcd", sys.argv[1:3] * 2, strict=True))
    for hold in ("zero", "first"):
        alone, shared = (run(parts, str, threads=threads, hold=hold) for threads in (1, 4))
        assert np.array_equal(alone, shared)
    print("with a race:", file=sys.stderr, flush=True)
    run(parts, lambda text: text.replace("__ATOMIC_ACQUIRE", "__ATOMIC_RELAXED"), threads=4)
