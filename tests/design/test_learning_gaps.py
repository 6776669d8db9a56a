"""Clocks that jump, samples that are lost, flights of another clock: what is learned stays, and it is said."""

from functools import partial

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, Reading, Recording, Sampling, Search, learn

H = 0.01
POLE = 40.0
QUICK = Search(starts=0, cross_validate=False)
# One step of 6000 is left out at a gap.
LEFT_OUT = 1e-3
# Of a noisy label: the standard error of the pole is 0.7 % here.
NOISY = 0.03


def signals(seed=0, n=6000):
    """x a random walk, and what a filter of one pole makes of it, with a tenth of noise."""
    rng = np.random.default_rng(seed)
    x = H * np.cumsum(rng.standard_normal((n, 2)), axis=0)
    label = PhyFilter([POLE]).sampled(H).run(x)
    return x, label + 0.1 * np.std(label) * rng.standard_normal(label.shape)


def log(times, rows=slice(None), seed=0, **options):
    x, label = signals(seed)
    return Recording(times[rows], x[rows], label=label[rows], **options)


def clock(jump=0.0):
    times = H * np.arange(6000)
    times[3000:] += jump
    return times


@pytest.fixture(scope="module")
def whole():
    return learn(log(clock()), 1, search=QUICK)


@pytest.mark.parametrize("jump", [5.0, 600.0, 3600.0])
def test_a_jump_of_the_clock_changes_nothing(whole, jump):
    found = learn(log(clock(jump)), 1, search=QUICK)
    assert found.filter.a[0] == pytest.approx(whole.filter.a[0], rel=LEFT_OUT)
    assert found.status == whole.status == "converged"
    assert found.sampled().dt == pytest.approx(H, rel=1e-9)
    (note,) = [note for note in found.notes if "gap" in note]
    assert note.startswith("1 gaps in the times of 1 of 1 flights")
    assert f"the longest {jump + H:.4g} s in flight 0" in note


def test_lost_samples_do_not_change_the_step():
    rows = np.random.default_rng(1).random(6000) > 0.1
    found = learn(log(clock(), rows), 1, search=QUICK)
    assert found.filter.a[0] == pytest.approx(POLE, rel=NOISY)
    assert found.sampled().dt == pytest.approx(H, rel=1e-9)
    assert any("samples are lost" in note for note in found.notes)


def test_weights_folds_and_files_take_the_parts_of_a_log_as_one_flight(tmp_path):
    logs = [log(clock(600.0 * (seed % 2)), seed=seed, channels=["p", "q"]) for seed in range(4)]
    weights = [np.ones(6000), 1.0, 1.0, np.repeat([0.0, 1.0], 3000)]
    found = learn(logs, 1, weights=weights, search=Search(starts=0, cross_validate=True))
    assert [score.flight for score in found.flights] == [0, 1, 2, 3]
    with_files = [tmp_path / f"{i}.csv" for i in range(4)]
    for path, each in zip(with_files, logs, strict=True):
        each.to_csv(path)
    read = partial(Recording.from_csv, x=["p", "q"], label=["label_p", "label_q"])
    stored = learn(
        with_files,
        1,
        weights=weights,
        search=Search(starts=0, cross_validate=True),
        reading=Reading(read=read, workers=1),
    )
    assert stored.filter.a[0] == pytest.approx(found.filter.a[0], rel=1e-6)
    assert stored.notes == found.notes
    np.testing.assert_allclose(
        [score.left_out_rmse for score in stored.flights],
        [score.left_out_rmse for score in found.flights],
        rtol=1e-6,
    )


@pytest.mark.parametrize("delay", [0.0, 1.5 * H])
@pytest.mark.parametrize("step", [5.0 * H, 30.0 * H, 600.0])
def test_a_filter_is_learned_back_over_what_run_makes_of_a_gap(step, delay):
    """5 steps are one longer step, 30 and more none, in ``run`` as in ``learn``."""
    times = clock(step - H)
    x, f_theta = signals()[0], np.sin(3.0 * H * np.arange(6000))[:, None] * [1.0, 0.5]
    label = PhyFilter([POLE]).sampled(H, delay=delay).run(x, f_theta=f_theta, times=times)
    found = learn(
        Recording(times, x, f_theta=f_theta, label=label), 1, sampling=Sampling(delay=delay), search=QUICK
    )
    assert found.filter.a[0] == pytest.approx(POLE, rel=1e-6)
    assert found.rmse < 1e-6 * np.std(label)


# -- flights that are not of one kind ------------------------------------------------------------------------


def test_a_flight_in_milliseconds_is_named_or_left_out():
    good = [log(clock(), seed=seed, name=f"good {seed}") for seed in range(2)]
    late = log(1e3 * clock(), seed=2, name="late")
    with pytest.raises(
        ValueError, match=r"recordings: late: its steps are 10 s, those of other flights 0\.01 s"
    ):
        learn([*good, late], 1, search=QUICK)
    found = learn([*good, late], 1, reading=Reading(on_bad="skip"), search=QUICK)
    assert found.filter.a[0] == learn(good, 1, search=QUICK).filter.a[0]
    assert [name for name, _ in found.skipped] == ["late"]
    stored = learn([*good, lambda: late], 1, reading=Reading(on_bad="skip", workers=1), search=QUICK)
    assert stored.filter.a[0] == pytest.approx(found.filter.a[0], rel=1e-9)
    with pytest.raises(ValueError, match=r"good 0: its steps are 0\.01 s, those of other flights 10 s"):
        learn([good[0], late], 1, reading=Reading(on_bad="skip"), search=QUICK)


def test_channels_are_those_of_the_first_flight():
    x, label = signals()
    one = Recording.from_arrays(x=x, dt=H, label=label, channels=["p", "q"])
    other = Recording.from_arrays(x=x[:, ::-1], dt=H, label=label[:, ::-1], channels=["q", "p"])
    fewer = Recording.from_arrays(x=x[:, :1], dt=H, label=label[:, :1], channels=["p"])
    with pytest.raises(ValueError, match="log 1 has 2 channels, q, p, where the first flight has p, q"):
        learn([one, other], 1, search=QUICK)
    with pytest.raises(ValueError, match="log 1 has 1 channels, p, where"):
        learn([one, fewer], 1, search=QUICK)
    with pytest.raises(ValueError, match="held_out: has 1 channels, p, where"):
        learn(one, 1, held_out=fewer, search=QUICK)
    by_name = learn([one, other], 1, channels=["p", "q"], search=QUICK)  # matched by name
    assert by_name.filter.a[0] == pytest.approx(learn([one, one], 1, search=QUICK).filter.a[0], rel=1e-9)
    assert learn([one, fewer], 1, channels=["p"], held_out=other, search=QUICK).held_out_rmse is not None
