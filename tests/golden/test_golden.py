"""The golden figures: the same twice, and a change of a billionth is seen."""

import json
from dataclasses import replace

import pytest

import phyfilter_ctl as pf
from tests.golden import cases
from tests.golden.__main__ import differences, main


def test_a_case_says_the_same_twice():
    first, second = (json.loads(json.dumps(cases.of_filter(3))) for _ in range(2))
    assert list(differences(first, second)) == []
    assert len(first) > 100
    assert sum(str(value).startswith("refused") for value in first.values()) < 6


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ({"a": 1.0}, {"a": 1.0 + 1e-11}, []),
        ({"a": 1.0}, {"a": 1.0 + 1e-8}, ["a: 1.0 was, 1.00000001 is"]),
        ({"a": 0.0}, {"a": 1e-13}, []),
        ({"a": 1.0}, {"a": "refused: ValueError"}, ["a: 1.0 was, 'refused: ValueError' is"]),
        ({"a": 1.0}, {"b": 1.0}, ["a: is gone", "b: is new"]),
        ({"a": "inf"}, {"a": "inf"}, []),
    ],
)
def test_what_differs_is_told(before, after, told):
    assert list(differences(before, after)) == told


def test_a_changed_figure_ends_with_status_1(tmp_path, monkeypatch, capsys):
    path = str(tmp_path / "golden.json")
    which = ["--only", "filters", "--count", "2"]
    monkeypatch.setattr("sys.argv", ["golden", "record", path, *which])
    assert main() == 0
    monkeypatch.setattr("sys.argv", ["golden", "compare", path, *which])
    assert main() == 0
    right = pf.error_bound

    def off(system, disturbance, **options):
        return right(system, replace(disturbance, noise=disturbance.noise + 1e-6), **options)

    monkeypatch.setattr(pf, "error_bound", off)
    assert main() == 1
    assert "bound, exact" in capsys.readouterr().out


def test_the_cases_are_of_all_kinds():
    systems = [cases.random_filter(seed) for seed in range(60)]
    sampled = [system for system in systems if isinstance(system, pf.SampledPhyFilter)]
    assert {system.order for system in systems} == {1, 2, 3, 4}
    assert 15 < len(sampled) < 45
    assert any(system.sampling.delay for system in sampled)
    assert any(system.sampling.limit is not None for system in sampled)
    assert any(
        system.b[-1] != 0.0 for system in systems if isinstance(system, pf.PhyFilter) and system.order > 1
    )


@pytest.mark.parametrize("number", range(6))
def test_every_recording_is_learned_from(number):
    found = cases.of_learning(number, "lowpass", 1)
    assert not [value for value in found.values() if str(value).startswith("refused")]
    assert found["learned.filter.a[0]"] > 0.0
