"""The headline of the designer and of the command is that of ``analyze``, for one file and one loop."""

import pytest
from designer_messages import message_of

import phyfilter_ctl as pf
from phyfilter_ctl.app import answers
from phyfilter_ctl.app.checking import Fields
from phyfilter_ctl.app.designs import read_design
from phyfilter_ctl.cli import main

# Poles, step, lag, delay; in the second a part of a step costs 0.1 ms of the delay that whole steps would allow.
DESIGNS = [
    ([-20.0, -30.0], 0.002, 0.02, 0.005),
    ([-87.0664478545601], 0.005944329548371446, 0.005, 0.0),
    ([-400.0, -400.0], 0.002, 0.05, 0.02),  # unstable
]


@pytest.mark.parametrize(("poles", "dt", "lag", "delay"), DESIGNS)
def test_the_designer_and_the_command_say_what_analyze_says(poles, dt, lag, delay, tmp_path, capsys):
    filter = pf.PhyFilter.from_poles(poles).sampled(dt, units={"f": "N"})
    expected = pf.analyze(filter, pf.Loop(actuator=lag, delay=delay), {1: 3.0})
    design = read_design(Fields({"design": message_of(poles, dt=dt, lag=lag, delay=delay, slope=3.0)}))
    said = answers.answer(design)["verdict"]
    assert [(each["text"], each["level"]) for each in said] == [(e.text, e.level) for e in expected.verdict]
    path = tmp_path / "filter.toml"
    pf.save(path, filter)
    assert main(["analyze", str(path), "--slope", "3", "--lag", repr(lag), "--delay", repr(delay)]) == 0
    assert capsys.readouterr().out.splitlines()[0] == expected.headline
