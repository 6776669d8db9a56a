"""Code of 0.2 rewritten: passages of our own notebooks and pages of then, and what is left to a reader."""

from __future__ import annotations

import textwrap

import pytest

from phyfilter_ctl.migrate import main, migrated

# Notebooks 2, 3, 4 and the pages on tubes, loops and inertia, as 0.2 had them.
PASSAGES = [
    (
        """
        import phyfilter_ctl as pf
        result = pf.ultimate_bound(filter, residual={1: 3.0})
        print(f"{method:14}{pf.ultimate_bound(filter, residual={1: 3.0}, method=method).bound:12.4g} N")
        limits[order] = pf.prior_margin(f).max_ratio
        lagging[order] = pf.prior_margin(f, actuator=lag, delay=0.01).max_ratio
        complete = pf.loop_margin(filter, kp=10.0, kd=6.0, actuator=lag, delay=0.01)
        noise = float(np.sqrt(pf.error_variance(sampled, noise=0.005 * MASS).noise))
        """,
        """
        import phyfilter_ctl as pf
        result = pf.error_bound(filter, {1: 3.0})
        print(f"{method:14}{pf.error_bound(filter, {1: 3.0}, method=method).bound:12.4g} N")
        limits[order] = pf.margins(f).max_ratio
        lagging[order] = pf.margins(f, pf.Loop(actuator=lag, delay=0.01)).max_ratio
        complete = pf.margins(filter, pf.Loop(10.0, 6.0, actuator=lag, delay=0.01))
        noise = float(np.sqrt(pf.error_variance(sampled, pf.Gaussian(noise=0.005 * MASS)).noise))
        """,
    ),
    (
        """
        import phyfilter_ctl as pf
        t = pf.tracking_tube(
            filter, residual={0: 2.0}, actuation={0: 0.5}, noise=0.03, command_limit=25.0
        )
        result = pf.learn(log, 1, loop=pf.LoopConstraint(**loop, modulus_margin=0.5))
        """,
        """
        import phyfilter_ctl as pf
        t = pf.tracking_error(filter, pf.Loop(command_limit=25.0), pf.Bounded({0: 2.0}, noise=0.03, actuation={0: 0.5}))
        result = pf.learn(log, 1, loop=pf.LoopGoal(modulus_margin=0.5, **loop))
        """,
    ),
    (
        """
        from phyfilter_ctl import PhyFilter, loop_margin, moving_inertia
        from phyfilter_ctl.analysis import BoundResult, gauss_markov
        from phyfilter_ctl.simulation import FilterPlace, simulate
        found: BoundResult = moving_inertia(PhyFilter([20.0]), ratios=(0.5, 2.0), delay=0.01)
        margin = loop_margin(PhyFilter([20.0]), kp=KP, kd=KD, actuator=ct.tf(1, [LAG, 1]))
        """,
        """
        from phyfilter_ctl import Loop, PhyFilter, gauss_markov, inertia_tolerance, margins
        from phyfilter_ctl.loops import FilterPlace
        from phyfilter_ctl.analysis import ErrorBound
        from phyfilter_ctl.simulation import simulate
        found: ErrorBound = inertia_tolerance(PhyFilter([20.0]), Loop(delay=0.01), ratios=(0.5, 2.0))
        margin = margins(PhyFilter([20.0]), Loop(KP, KD, actuator=LAG))
        """,
    ),
]


@pytest.mark.parametrize(("before", "after"), PASSAGES)
def test_passages_of_then(before, after):
    new, left = migrated(textwrap.dedent(before))
    assert sorted(new.splitlines()) == sorted(textwrap.dedent(after).splitlines())
    assert not left
    assert migrated(new) == (new, [])


def test_docstrings_and_pages_are_read_too(tmp_path, capsys):
    module, page = tmp_path / "own.py", tmp_path / "page.md"
    module.write_text(
        '''def f():
    """Margins.

    >>> from phyfilter_ctl import PhyFilter, prior_margin
    >>> prior_margin(PhyFilter([20.0]),
    ...              delay=0.01).is_stable
    True
    """
'''
    )
    page.write_text("Text on prior_margin.\n\n```python\nm = pf.disk_margin(L)\n```\n")
    before = module.read_text()
    assert main([str(tmp_path)]) == 0
    assert module.read_text() == before
    assert "+m = pf.margins(L).disk" in capsys.readouterr().out
    assert main(["--write", str(tmp_path)]) == 0
    assert ">>> from phyfilter_ctl import Loop, PhyFilter, margins\n" in module.read_text()
    assert ">>> margins(PhyFilter([20.0]), Loop(delay=0.01)).is_stable\n    True\n" in module.read_text()
    assert page.read_text() == "Text on prior_margin.\n\n```python\nm = pf.margins(L).disk\n```\n"


def test_what_is_left_is_listed_and_strangers_are_left_alone(tmp_path, capsys):
    own = tmp_path / "own.py"
    own.write_text(
        "import phyfilter_ctl as pf\nfor ask in (pf.ultimate_bound, other.loop_margin(kp=1)):\n    ask()\n"
        "verdict = margin.inertia_within(M_hat, 0.1)\n"
    )
    assert main(["--write", str(own)]) == 1
    told = capsys.readouterr().out
    assert "line 2: ultimate_bound" in told
    assert "line 4: inertia_within" in told
    assert "other.loop_margin(kp=1)" in own.read_text()
    own.write_text("def (:\n")
    assert main([str(own)]) == 1
    assert "not Python" in capsys.readouterr().out


def test_what_is_elsewhere_now_is_listed():
    """Where the script cannot tell what to write, it says so: nothing that warns is passed over."""
    code = (
        "import phyfilter_ctl as pf\n"
        "from phyfilter_ctl.learned import OnnxNetwork\n"
        "from phyfilter_ctl import Signals, fmi\n"
        "pf.save('f.toml', F, signals=pf.Signals(['a']))\n"
        "r = fmi.read_reference('x_out.csv')\n"
    )
    new, left = migrated(code)
    assert new == code
    said = "\n".join(left)
    for line, words in (
        (2, "phyfilter_ctl.learned.onnx"),
        (3, "Sampling"),
        (4, "Sampling"),
        (5, "Reference.read"),
    ):
        assert any(each.startswith(f"line {line}:") and words in each for each in left), said
