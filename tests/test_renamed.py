"""Names of 0.2 warn and work."""

from __future__ import annotations

import importlib
import re

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import _renamed, controllers
from phyfilter_ctl.migrate import _TO_REWRITE, migrated

F = pf.PhyFilter.from_poles([-20.0] * 3)
LAG = ct.tf(1, [0.02, 1])
PLANT = ct.tf([1.0], [1.0, 3.0, 3.0, 1.0], inputs="u", outputs="y", name="plant")
LAW = ct.tf([2.0], [1.0], inputs="e", outputs="u", name="p")
DIAGRAM = ct.interconnect(
    [PLANT, LAW, ct.summing_junction(["r", "-y"], "e", name="error")], inputs="r", outputs="y"
)
LOG = pf.Recording.from_arrays(x=np.random.default_rng(0).standard_normal((200, 1)), dt=0.01)
LABELLED = pf.Recording.from_arrays(
    x=0.1 * LOG.x + np.cumsum(0.01 * np.sin(0.02 * np.arange(200.0)))[:, None],
    dt=0.01,
    label=np.sin(0.02 * np.arange(200.0))[:, None],
)
FAST = pf.Recording.from_arrays(x=3.0 * LOG.x[:100], dt=0.01)
LABELLED = LOG.with_signals(label=F.sampled(0.01).run(LOG.x))
X = np.random.default_rng(1).standard_normal((300, 2))
PLANE = pf.Recording.from_arrays(x=X, dt=0.01, label=F.sampled(0.01).run(X))
NAMES = {
    "PLANE": PLANE,
    "LABELLED": LABELLED,
    "LOG": LOG,
    "SEPARATED": pf.separate(LOG, [pf.estimation.SteadyForce(99.0, name="force")], noise=1.0, causal=True),
    "FAST": FAST,
    "pf": pf,
    "F": F,
    "LAG": LAG,
    "DIAGRAM": DIAGRAM,
    "ct": ct,
    "np": np,
}
# What 0.2 wrote, one for each name and way of use.
OLD = [
    "pf.prior_margin(F, actuator=LAG, delay=0.01, inertia_ratio=1.2)",
    "pf.prior_margin(F, dt=0.002, g='applied')",
    "pf.prior_margin(F, actuator=ct.tf(1, [0.05, 1]))",
    "pf.loop_margin(F, kp=10.0, kd=6.0, delay=0.01, dt=0.002)",
    "pf.loop_margin(F, kp=0.0, kd=0.0)",
    "pf.disk_margin(ct.tf(1, [1, 1, 0]))",
    "pf.disk_margin(ct.tf(1, [1, 1, 0]), skew=0.5)",
    "pf.signal_margin(DIAGRAM, 'plant.u')",
    "pf.moving_inertia(F, ratios=(0.5, 2.0), rate=0.0, actuator=LAG)",
    "pf.saturation_margin(F, kp=10.0, kd=6.0, g='commanded')",
    "pf.largest_bandwidth(lambda w: pf.PhyFilter([w]), delay=0.02, modulus_margin=0.5)",
    "pf.ultimate_bound(F, residual={1: 3.0})",
    "pf.ultimate_bound(F, residual={0: 1.0, 1: 3.0}, noise=0.01, inertia_error=0.1, rate=2.0, method='exact')",
    "pf.error_variance(F.sampled(0.01), residual=pf.gauss_markov(1.0, 0.5), noise=0.01)",
    "pf.tracking_tube(F, kp=10.0, kd=6.0, residual=[{1: 2.0}, {0: 0.1}], actuation={0: 0.1}, dt=0.01)",
    "pf.tracking_deviation(F, kp=10.0, kd=6.0, residual=pf.gauss_markov(1.0, 0.5), dt=0.01)",
    "pf.analyze(F, kp=10.0, kd=6.0, residual={1: 3.0}, noise=0.01)",
    "pf.pole_zero_map(F)",
    "pf.LoopConstraint(kp=10.0, kd=6.0, modulus_margin=0.4)",
    "pf.place_poles([-20.0, -15.0], numerator=2)",
    "pf.lowpass(3, 20.0, family='bessel', numerator=3)",
    "pf.lowpass(3, 20.0, numerator='lowpass')",
    "pf.estimation.detect_changes(SEPARATED, 'force', within=0.1)",
    "pf.compare_estimators(LOG, pf.PhyFilter([5.0]), max_evaluations=2)",
    "pf.known_noise(0.005)",
    "pf.known_noise(spectrum=([0.0, 1e3], [1e-8, 1e-8]), dt=0.002)",
    "pf.measurement_noise(LOG, start=0.1, end=0.9, confidence=0.9)",
    "pf.split_by_speed([LOG, FAST])",
    "pf.split_by_speed([LOG, FAST], 0.4, percentile=50.0)",
    "pf.split_flights([LOG, FAST], key=lambda log: log.n, fraction=0.4)",
    "pf.learn(LABELLED, 2, form='general', starts=0, wiener=False)",
    "pf.learn(LABELLED, 2, form='general', type=2, damping=0.4, start=None, starts=0, max_iterations=5)",
    "pf.learn(LABELLED, 1, g='average', delay=0.01, label_offset=True, intervals=False, starts=0)",
    "pf.learn_axes([PLANE], lambda logs: pf.learn(logs, 1, starts=0, wiener=False))",
    "pf.learn([lambda: LABELLED], 1, workers=1, on_bad='skip', scheduler=None, wiener=False)",
]
KEPT = ("saturation_margin", "largest_bandwidth", "error_variance", "analyze")


def same(one: object, other: object) -> bool:
    told = [each.to_dict() if isinstance(each, pf.Result) else repr(each) for each in (one, other)]
    return told[0] == told[1]


@pytest.mark.parametrize("old", OLD)
def test_migrated_code_says_what_the_old_name_says(old):
    new, left = migrated(f"import phyfilter_ctl as pf\nfound = {old}\n")
    assert not left
    assert len(new) < len(old) + 70
    assert migrated(new)[0] == new
    now: dict[str, object] = dict(NAMES)
    exec(new, now)
    if not any(f"pf.{name}(" in old for name in KEPT):
        with pytest.warns(DeprecationWarning, match=r"is now .*\n.*migrate"):
            before = eval(old, dict(NAMES))
        assert same(before, now["found"])


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_options_of_learn_were_keywords():
    """Old and new ones mix, as where a call of the new form takes a dictionary of old ones."""
    kept = pf.Search(starts=0, seed=3)
    found = pf.learn(logs=LABELLED, order=1, shape="general", dc_gain=None, search=kept, max_iterations=5)
    wanted = pf.learn(
        LABELLED,
        1,
        shape=pf.Shape("general", dc_gain=None),
        search=pf.Search(starts=0, seed=3, max_iterations=5),
    )
    assert same(found, wanted)
    assert found.intervals is not None  # computed when asked for, whatever intervals= was
    with pytest.raises(TypeError, match="nonsense"):
        pf.learn(LABELLED, 1, nonsense=1)


def test_every_name_of_the_table_has_a_case():
    below = {*_TO_REWRITE}
    assert {*_renamed.FUNCTIONS} - below <= set(re.findall(r"pf\.(?:estimation\.)?(\w+)\(", " ".join(OLD)))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_channels_had_lists_of_numbers():
    bank = pf.stack([F, pf.PhyFilter([5.0])])
    found = pf.loop_margin(bank, kp=[10.0, 4.0], kd=6.0)
    assert [each.delay_margin for each in found] == [
        pf.margins(F, pf.Loop(10.0, 6.0)).delay_margin,
        pf.margins(pf.PhyFilter([5.0]), pf.Loop(4.0, 6.0)).delay_margin,
    ]
    found = pf.ultimate_bound(bank, residual=[{1: 3.0}, {1: 1.0}], noise=0.01)
    assert found[1].bound == pf.error_bound(pf.PhyFilter([5.0]), pf.Bounded({1: 1.0}, noise=0.01)).bound
    assert len(pf.prior_margin(bank)) == 2


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_sets_of_matrices_were_methods_of_the_inner_margins():
    margin = pf.prior_margin(F)
    assert isinstance(margin, pf.FilterMargins)
    assert isinstance(margin, pf.PriorMargin)
    verdict = margin.inertia([2.0, 0.5], [1.0, 1.0])
    assert isinstance(verdict, pf.InertiaVerdict)
    assert (verdict.stable, verdict.test, verdict.status) == (True, "eigenvalues", "proven")
    assert not pf.prior_margin(F, inertia_ratio=1.2).inertia_between(1.0, 0.05, 5.0).stable
    assert margin.inertia([2.0, 10.0], [1.0, 1.0]).message == "unstable at the eigenvalue 10 of M_hat M^-1"
    assert margin.inertia_between(1.0, 0.2, 5.0).status == "proven"
    assert margin.inertia_within([2.0, 1.0], 0.5).method == "small gain"
    assert margin.inertia_hull([1.0], [1.0], deviation=[[0.1]]).status == "proven"


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("analysis", "BoundResult"),
        ("analysis", "PriorMargin"),
        ("analysis", "LoopMargin"),
        ("analysis", "gauss_markov"),
        ("analysis", "Implementation"),
        ("simulation", "FilterPlace"),
        ("simulation", "linearize_sampled"),
        ("simulation", "sampled_open_loop"),
        ("simulation", "signal_margin"),
        ("diagram", "SignalMargin"),
        ("filter", "LivePolicy"),
        ("plots", "pole_plot"),
        ("codegen", "write_folder"),
        ("design", "LoopConstraint"),
        ("design.learning", "LoopConstraint"),
        ("estimation", "NoiseLevel"),
        ("estimation", "known_noise"),
        ("recording", "split_by_speed"),
        ("estimation", "detect_changes"),
        ("estimation", "EstimatorComparison"),
        ("recording", "Suspicion"),
        ("robot", "RobotCheck"),
        ("robot", "Finding"),
        ("study", "Interval"),
        ("filter", "Interval"),
        ("design.optimal", "Interval"),
        ("design", "margin_trade_off"),
        ("design", "MarginTradeOff"),
        ("design.optimal", "TradeOff"),
        ("design.optimal", "bound_trade_off"),
    ],
)
def test_every_module_that_had_a_name_knows_it(module, name):
    room = importlib.import_module(f"phyfilter_ctl.{module}")
    with pytest.warns(DeprecationWarning, match=f"phyfilter_ctl.{module}.{name} is now"):
        assert getattr(room, name) is not None
    assert name not in room.__all__
    with pytest.raises(AttributeError, match="no attribute 'never'"):
        _ = room.never


def test_what_never_was_is_no_attribute():
    with pytest.raises(AttributeError, match="no attribute 'never'"):
        _ = pf.never


@pytest.mark.parametrize("name", ["1/k", "fmi/shell", "", ".", "no such"])
def test_what_can_be_no_name_is_no_attribute(name):
    assert not hasattr(pf, name)
    assert not hasattr(pf.design, name)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_signals_beside_a_filter(tmp_path):
    """What 0.2 wrote of them, into files, C and FMUs."""
    noted = pf.Signals(["a", "b"], unit_x="m/s", inertia=[2.0, 3.0])
    known = {"channels": ["a", "b"], "units": {"x": "m/s"}, "inertia": [2.0, 3.0]}
    for system in (F, F.sampled(0.01)):
        pf.save(tmp_path / "f.toml", system, signals=noted)
        sampled = pf.load(tmp_path / "f.toml", **({"dt": 0.01} if system is F else {}))
        assert sampled == F.sampled(0.01, **known)
        found = pf.load_signals(tmp_path / "f.toml")
        assert (found.channels, found.unit_x, found.unit_g, found.inertia) == (
            ("a", "b"),
            "m/s",
            "",
            [2.0, 3.0],
        )
    pf.export_c(F.sampled(0.01), tmp_path / "old", signals=noted)
    pf.export_c(F.sampled(0.01, **known), tmp_path / "new")
    texts = [
        {path.name: path.read_text() for path in (tmp_path / name).glob("*.[ch]")} for name in ("old", "new")
    ]
    assert texts[0] == texts[1]
    for name, given in (("old", {"signals": noted}), ("new", known)):
        pf.export_fmu(F, tmp_path / f"{name}.fmu", platforms=(), **given)
    assert (tmp_path / "old.fmu").read_bytes() == (tmp_path / "new.fmu").read_bytes()
    with pytest.warns(DeprecationWarning, match="signals"):
        pf.save(tmp_path / "f.toml", F, signals=None)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_references_were_read_and_written_by_functions(tmp_path):
    fmi = importlib.import_module("phyfilter_ctl.fmi")
    reference = fmi.Reference(np.arange(3.0), {"u": np.ones(3)}, {"y": np.arange(3.0)})
    fmi.write_reference(tmp_path / "a_out.csv", reference)
    np.testing.assert_array_equal(
        fmi.read_reference(tmp_path / "a_out.csv").outputs["y"], reference.outputs["y"]
    )


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(("home", "names"), _renamed._INNER.items())
def test_names_inside_their_rooms_now(home, names):
    """Nor does a module of the same name stand in their way."""
    inner = importlib.import_module(f"phyfilter_ctl.{home}")
    room = importlib.import_module(f"phyfilter_ctl.{home.partition('.')[0]}")
    for name in names:
        assert getattr(room, name) is getattr(inner, name)
        assert name not in room.__all__


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_findings_were_a_function():
    log = pf.Recording(np.arange(100) * 1e4, np.sin(np.arange(100.0)))
    found = importlib.import_module("phyfilter_ctl.robot").findings_of(log)
    assert found == log.check().findings
    assert found[0].suspicion == importlib.import_module("phyfilter_ctl.robot").Suspicion.TIME_UNIT


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("attitude_gains", {"motor_lag": 0.04, "delay": 0.011}),
        ("position_controller", {"mass": 3.0, "kp": 4.0, "kd": 4.0, "dt": 0.002}),
        ("known_force", {"mass": 3.0, "motor_lag": 0.04, "rotor_max": 16.2, "delay_steps": 5, "dt": 0.002}),
        (
            "known_torque",
            {
                "J": [0.1] * 3,
                "arm": 0.2,
                "torque_ratio": 0.01,
                "motor_lag": 0.04,
                "rotor_max": 16.2,
                "dt": 0.002,
            },
        ),
    ],
)
def test_what_a_multirotor_makes_were_functions(name, given):
    with pytest.warns(DeprecationWarning, match=rf"{name} is now Multirotor\(\.\.\.\)\."):
        made = getattr(controllers, name)
    found = made(**given)
    drone = controllers.Multirotor(delay=0.01)
    if name == "attitude_gains":
        assert found == drone.gains(0.002)
    elif name == "position_controller":
        assert found.input_labels == drone.position(0.002, kp=4.0, kd=4.0).input_labels
    else:
        assert found.output_labels == getattr(drone, name)(0.002).output_labels
    _, left = migrated(f"from phyfilter_ctl.controllers import {name}\n")
    assert "Multirotor" in left[0]


GAINS = controllers.Multirotor(delay=0.01).gains(0.002)
BODY = "mass=3.0, J=[0.03] * 3, arm=0.25, torque_ratio=0.016, gravity=9.8, rotor_max=16.2, motor_lag=0.04, delay=0.01"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (
            f"attitude_controller({BODY}, kR=GAINS.kR, kw=GAINS.kw, lead_filter=GAINS.lead_filter, yaw=0.1, dt=0.002)",
            f"attitude_controller(Multirotor({BODY}), GAINS, yaw=0.1, dt=0.002)",
        ),
        (
            f"attitude_controller({BODY}, kR=[90.0, 4.0], kw=20.0, lead_filter=0.01, dt=0.002)",
            f"attitude_controller(Multirotor({BODY}), AttitudeGains([90.0, 4.0], 20.0, 0.01), dt=0.002)",
        ),
        ("aerial_manipulator(nominal_mass=3.0)", "aerial_manipulator(nominal=(3.0, None))"),
        (
            "aerial_manipulator(mass=2.5, servo_damping=0.8, nominal_mass=3.0, nominal_J=(0.1, 0.1, 0.1))",
            "aerial_manipulator(mass=2.5, servo=(40.0, 0.8), nominal=(3.0, (0.1, 0.1, 0.1)))",
        ),
    ],
)
def test_a_multirotors_numbers_were_given_one_by_one(old, new):
    module = "plants" if old.startswith("aerial") else "controllers"
    name = old.partition("(")[0]
    source = f"from phyfilter_ctl.{module} import {name}\nfound = {old}\n"
    text, left = migrated(source)
    assert not left
    assert text.endswith(f"found = {new}\n")
    assert migrated(text)[0] == text
    now = {"GAINS": GAINS}
    exec(text, now)
    with pytest.warns(DeprecationWarning, match=f"{name}.* is now "):
        exec(source, before := {"GAINS": GAINS})
    functions = [getattr(each["found"], "law", None) or each["found"].functions for each in (before, now)]
    starts = [[v.start for v in [*f.states, *f.inputs, *f.parameters]] for f in functions]
    assert starts[0] == starts[1]


def test_parts_of_bounds_had_another_name():
    bound = pf.error_bound(F, pf.Bounded({1: 3.0}, inertia_error=0.1, rate=2.0))
    for result in (bound, pf.error_budget([bound])):
        with pytest.warns(DeprecationWarning, match="prior is now inertia"):
            np.testing.assert_array_equal(result.prior, result.inertia)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_three_trade_offs_were_two_results():
    room = importlib.import_module("phyfilter_ctl.design.optimal")
    curve = room.bound_trade_off(2, residual={2: 8.0}, noise=0.01, type=2, inertia=2.0, points=5)
    best = room.least_bound(2, residual={2: 8.0}, noise=0.01, type=2, inertia=2.0)
    factors = np.geomspace(10.0**-0.5, 10.0, 5)
    np.testing.assert_allclose(curve.following, best.bound.intrinsic * factors**-2.0, rtol=1e-6)
    np.testing.assert_allclose(curve.noise, best.bound.noise * factors, rtol=1e-6)
    np.testing.assert_allclose(curve.filters[curve.best].a, best.filter.faster(factors[curve.best]).a)
    assert curve.label == "bound from |gamma^(2)| and |nu|"
    with pytest.raises(ValueError, match="one bounded derivative"):
        room.bound_trade_off(2, residual={0: 1.0, 1: 1.0}, noise=0.1)
    curve = room.variance_trade_off(2, residual=pf.gauss_markov(1.0, 0.5), noise=0.01, dt=0.01, points=3)
    assert isinstance(curve, room.TradeOff)
    assert (curve.best, curve.plot().axes.shape) == (1, (1, 1))
    goal = pf.LoopGoal(pf.Loop(10.0, 6.0, delay=0.04))
    found = pf.design.margin_trade_off(
        lambda each: pf.learn(LABELLED, 1, loop=each, wiener=False), goal, [0.3, 0.5]
    )
    assert isinstance(found, pf.design.MarginTradeOff)
    assert found.margins.tolist() == [0.3, 0.5]
    assert found.rmse.tolist() == [each.rmse for each in found.results]
    with pytest.raises(ValueError, match="modulus_margin"):
        pf.design.margin_trade_off(lambda each: pytest.fail("learned before it is refused"), goal, [0.3, 2.0])
    for name in ("bound_trade_off", "margin_trade_off"):
        assert f"{name} is now" in migrated(f"from phyfilter_ctl.design import {name}\n")[1][0]


def test_the_value_of_an_interval_was_the_median():
    found = importlib.import_module("phyfilter_ctl.study").median_interval([1.0, 2.0, 3.0])
    with pytest.warns(DeprecationWarning, match="Interval.median is now value"):
        assert found.median == found.value == 2.0


def test_types_were_numerators():
    with pytest.warns(DeprecationWarning, match=r"place_poles\(numerator=2\) is now place_poles\(type=2\)"):
        assert pf.place_poles([-20.0, -15.0], numerator=2) == pf.place_poles([-20.0, -15.0], type=2)
    assert pf.place_poles([-1.0, -2.0], numerator=[2.0, 1.0]).b.tolist() == [2.0, 1.0]
    kept = "import phyfilter_ctl as pf\nF = pf.place_poles(p, numerator=b)\n"
    assert migrated(kept)[0] == kept
    with pytest.warns(DeprecationWarning, match="numerator_of_type is now place_poles"):
        old = importlib.import_module("phyfilter_ctl.design").numerator_of_type
    assert old([400.0, 40.0], 1).tolist() == [400.0, 0.0]


LAG = ct.nlsys(
    lambda t, x, u, p: [p["k"] * (u[0] - x[0])], None, inputs=1, outputs=1, states=1, params={"k": 1.0}
)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (
            "pf.simulate(LAG, T, 1.0, max_steps=500, time_limit=9.0)",
            'pf.simulate(LAG, T, 1.0, limits={"max_steps": 500, "time_limit": 9.0})',
        ),
        ("pf.simulate(LAG, T, 1.0, t_eval=[0.5])", "pf.simulate(LAG, (T, [0.5]), 1.0)"),
        (
            "pf.simulate(LAG, T, 1.0, squeeze=False, progress=False)",
            "pf.simulate(LAG, T, 1.0)(squeeze=False)",
        ),
        (
            'pf.simulate_batch(LAG, T, 1.0, params={"k": [1.0, 2.0]}, workers=2)[1]',
            'pf.simulate_batch(LAG, T, 1.0, params={"k": [1.0, 2.0]}, limits={"workers": 2})[1]',
        ),
        (
            'pf.simulate_batch(LAG, T, 1.0, params={"k": [1.0, 2.0]}, executor=Executor(1))[1]',
            'pf.simulate_batch(LAG, T, 1.0, params={"k": [1.0, 2.0]}, limits={"workers": Executor(1)})[1]',
        ),
    ],
)
def test_limits_of_a_run_were_given_one_by_one(old, new):
    source = f"import phyfilter_ctl as pf\nfound = {old}\n"
    text, left = migrated(source)
    assert not left
    assert text.endswith(f"found = {new}\n")
    assert migrated(text)[0] == text
    given = {
        "LAG": LAG,
        "T": np.linspace(0.0, 1.0, 11),
        "Executor": importlib.import_module("phyfilter_ctl.execution").Executor,
    }
    exec(text, now := dict(given))
    with pytest.warns(DeprecationWarning, match="simulate.* is now "):
        exec(source, before := dict(given))
    np.testing.assert_array_equal(before["found"].outputs, now["found"].outputs)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("batch=2, max_epochs=3, optimiser=Adam(0.3)", "optimiser=Adam(0.3, batch=2, max_epochs=3)"),
        ("max_epochs=3, seed=4", "optimiser=Adam(max_epochs=3, seed=4)"),
    ],
)
def test_batches_and_epochs_were_given_beside_the_optimiser(old, new):
    source = (
        f"from phyfilter_ctl.design.adjoint import Adam, train\nfound = train(LOG, F, segment=20, {old})\n"
    )
    text, left = migrated(source)
    assert not left
    assert text.endswith(f"found = train(LOG, F, segment=20, {new})\n")
    assert migrated(text)[0] == text
    x = np.sin(0.1 * np.arange(200))[:, None]
    log = pf.Recording.from_arrays(x=x, dt=0.01, label=np.gradient(x[:, 0])[:, None])
    given = {"LOG": log, "F": pf.PhyFilter([1.0])}
    exec(text, now := dict(given))
    with pytest.warns(DeprecationWarning, match=r"train\(.* is now optimiser=Adam"):
        exec(source, before := dict(given))
    assert before["found"].history == now["found"].history


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_workers_and_executor_were_one_of_two():
    executor = importlib.import_module("phyfilter_ctl.execution").Executor(1)
    with pytest.raises(ValueError, match="workers and executor: expected one of them"):
        pf.simulate_batch(LAG, [0.0, 1.0], params={"k": [1.0]}, workers=2, executor=executor)
