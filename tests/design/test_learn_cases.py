"""What users write to learn a filter, case by case: one line each, and what comes back."""

import importlib.util
from unittest import mock

import numpy as np
import pytest
from scipy.signal import lfilter

import phyfilter_ctl as pf

H = 0.01
TRUTH = pf.PhyFilter([300.0, 25.0])
# A label of the filter itself: what the descent leaves is rounding.
EXACT = 1e-6


def recording(seed=0, n=1200, noise=0.0, **options):
    """A gust on a mass of two axes whose velocities are measured, labelled by the filter that is to be found."""
    rng = np.random.default_rng(seed)
    f = lfilter([0.3], [1.0, -0.97], rng.standard_normal((n, 2)), axis=0)
    x = np.cumsum(H * f, axis=0) + 0.01 * rng.standard_normal((n, 2))
    label = TRUTH.sampled(H).run(x) + noise * rng.standard_normal((n, 2))
    return pf.Recording.from_arrays(x=x, dt=H, label=label, channels=["vx", "vy"], **options)


log = recording()
logs = [recording(seed, 400) for seed in range(10)]
noisy = [recording(seed, 400, noise=0.05) for seed in range(10)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("flights")
    for k, each in enumerate(logs[:3]):
        each.to_csv(path / f"{k}.csv")
    return path


def is_the_truth(filter):
    np.testing.assert_allclose(filter.a, TRUTH.a, rtol=EXACT)
    return True


def test_one_labelled_recording():
    sampled = pf.learn(log, 2).sampled()
    assert is_the_truth(sampled.filter)
    assert sampled.dt == H


@pytest.mark.slow
def test_orders_by_cross_validation():
    result = pf.learn(noisy, range(1, 4), shape="general")
    assert result.order_used == 2
    assert [score.order for score in result.orders][:2] == [1, 2]


def test_some_recordings_held_out():
    result = pf.learn(logs[:8], 2, held_out=logs[8:])
    assert is_the_truth(result.filter)
    assert result.held_out_rmse < EXACT


def test_no_labels():
    bare = recording(n=3000).with_signals(label=None)
    assert pf.estimate(bare).filter.order >= 1
    with pytest.raises(ValueError, match=r"estimate\(log\), or smooth_label\(log\)"):
        pf.learn(bare, 2)
    assert pf.learn(pf.smooth_label(bare).recording, 2).filter.order >= 1


def test_a_label_that_lost_its_mean():
    lost = log.with_signals(label=log.label - 2.0)
    assert is_the_truth(pf.learn(lost, 2, label="offset").filter)


def test_in_a_loop():
    goal = pf.LoopGoal(pf.Loop(kp=10, kd=6, actuator=0.05, delay=0.01))
    result = pf.learn(log, 2, loop=goal)
    assert result.loop.binding
    assert pf.margins(result.sampled(), goal.loop).modulus_margin >= 0.5


def test_a_folder(folder):
    assert is_the_truth(
        pf.learn(folder, 2, reading=lambda path: pf.Recording.read(path, x=["vx", "vy"])).filter
    )


def test_odd_files(folder):
    def read(path):
        return pf.Recording.read(path, x=["vx", "vy"], label=["label_vx", "label_vy"], time_unit="s")

    paths = sorted(folder.glob("*.csv"))
    assert is_the_truth(pf.learn(paths, 2, reading=read).filter)
    assert is_the_truth(pf.learn(paths, 2, reading=pf.Reading(read, on_bad="skip", workers=1)).filter)


def test_a_robot_reads_its_logs(folder):
    with mock.patch.object(pf.Robot, "read", lambda self, path: pf.Recording.read(path, x=["vx", "vy"])):
        robot = object.__new__(pf.Robot)  # of whatever file
        assert is_the_truth(pf.learn(sorted(folder.glob("*.csv")), 2, reading=robot).filter)
    with pytest.raises(TypeError, match="reading: expected a Reading, a Robot or a function"):
        pf.learn(log, 2, reading=3)


@pytest.mark.release
@pytest.mark.skipif(not importlib.util.find_spec("distributed"), reason="the extra cluster is not installed")
def test_a_cluster_reads(folder):
    distributed = importlib.import_module("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
        ) as own,
        distributed.Client(own, set_as_default=False) as client,
    ):
        how = pf.Reading(lambda path: pf.Recording.read(path, x=["vx", "vy"]), workers=client)
        assert is_the_truth(pf.learn(sorted(folder.glob("*.csv")), 2, reading=how).filter)


def started(seed, n=1200):
    """A recording whose label is nonsense for 2 s."""
    good = recording(seed, n)
    label = np.array(good.label)
    label[:200] = 50.0 * np.random.default_rng(seed).standard_normal((200, 2))
    return good.with_signals(label=label)


@pytest.mark.parametrize("label", ["given", "offset"])
@pytest.mark.parametrize("form", ["lowpass", "general"])
def test_a_start_left_out(label, form):
    """The filter runs through it, and neither the answer nor a score counts it."""
    bad, how = [started(seed) for seed in range(6)], {"shape": form, "label": label}
    result = pf.learn(bad, 2, reading=pf.Reading(skip=2.0), held_out=started(9), **how)
    assert is_the_truth(result.filter)
    assert max(result.rmse, result.held_out_rmse) < EXACT
    assert max(result.wiener.filter_rmse, *(each.left_out_rmse for each in result.flights)) < EXACT
    assert result.intervals.rmse.high < EXACT
    assert result.notes == ("no g: M x' is taken as f",)
    read = pf.learn(
        [lambda each=each: each for each in bad], 2, reading=pf.Reading(skip=2.0, workers=1), **how
    )
    np.testing.assert_allclose(read.filter.a, result.filter.a, rtol=EXACT)
    assert read.rmse < EXACT


def test_a_start_left_out_of_uneven_steps():
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.uniform(0.5, 1.5, 1200)) * H
    x = np.cumsum(rng.standard_normal((1200, 1)), axis=0)
    label = np.array(TRUTH.sampled(H).run(x, times=times))
    label[: np.searchsorted(times, times[0] + 2.0)] = 99.0
    log = pf.Recording(times, x, label=label)
    result = pf.learn(log, 2, reading=pf.Reading(skip=2.0), search=pf.Search(starts=0))
    assert is_the_truth(result.filter)
    assert result.rmse < EXACT
    with pytest.raises(ValueError, match=r"skip: expected less than the .* s that log 0 lasts, got 99 s"):
        pf.learn(log, 2, reading=pf.Reading(skip=99.0))
    with pytest.raises(ValueError, match="skip: expected"):
        pf.Reading(skip=-1.0)


def test_what_F_must_be():
    result = pf.learn(log, 4, shape=pf.Shape("general", type=2, zeros_at=[6.28], damping=0.4))
    F = result.filter
    assert abs(1.0 - F(6.28j)) < EXACT
    assert F.type >= 2
    assert np.all(-F.poles().real >= 0.4 * np.abs(F.poles()) * (1.0 - EXACT))


def test_how_it_will_run():
    sampling = pf.Sampling(0.005, "tustin", limit=3.0)
    result = pf.learn(log, 2, sampling=sampling)
    assert result.sampled().sampling == sampling
    assert "for steps of 0.005 s" in " ".join(result.notes)
    assert pf.learn(log, 2, sampling=pf.Sampling(g="average")).sampled().dt == H
    with pytest.raises(ValueError, match="dt: expected the sampling interval"):
        TRUTH.sampled(pf.Sampling(g="average"))
    with pytest.raises(ValueError, match="x has 2 channels"):
        pf.learn(log, 2, sampling=pf.Sampling(channels=3))


def test_a_filter_each():
    two = log.with_signals(label=pf.stack([pf.PhyFilter([5.0]), pf.PhyFilter([40.0])]).sampled(H).run(log.x))
    found = pf.learn(two, 1, axes="each", weights=np.ones((log.n, 2)), sampling=pf.Sampling(limit=[1.0, 9.0]))
    assert found.choice == "each"
    assert [F.a[0] for F in found.filter] == pytest.approx([5.0, 40.0], rel=EXACT)
    assert found.sampled().sampling.limit.tolist() == [1.0, 9.0]
    (only,) = pf.learn(two, 1, axes="each", channels=["vy"]).results["each"]
    assert only.filter.a[0] == pytest.approx(40.0, rel=EXACT)
    with pytest.raises(ValueError, match="expected no E"):
        pf.learn(two, 1, axes="each", sampling=pf.Sampling(E=np.eye(2)))


@pytest.mark.slow
def test_one_or_each_or_a_matrix():
    hazy = recording(n=600, noise=0.05)
    quick = pf.Search(starts=0, cross_validate=False)
    found = pf.learn(hazy, 1, axes="compare", search=quick)
    assert {*found.scores} == {"shared", "each", "coupled"}
    assert found.choice == "shared"
    for given in ({"weights": 1.0}, {"held_out": log}, {"sampling": pf.Sampling(limit=1.0)}):
        with pytest.raises(ValueError, match="expected none with axes='compare'"):
            pf.learn(hazy, 1, axes="compare", **given)
    with pytest.raises(ValueError, match="axes: expected one of shared, each, compare"):
        pf.learn(hazy, 1, axes="both")
