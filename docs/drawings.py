"""The block diagrams of README, pages and docstrings, drawn anew: `python docs/drawings.py`.

The site's build does so too. What stands in `docs/drawn` is committed, so that pages read in a checkout show it.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import control as ct
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl import models

FOLDER = Path(__file__).resolve().parent / "drawn"


def _tf(
    numerator: list[float], denominator: list[float], input: str, output: str, name: str
) -> ct.TransferFunction:
    return ct.TransferFunction(numerator, denominator, inputs=input, outputs=output, name=name)


def _box(name: str, inputs: Mapping[str, int], outputs: Mapping[str, int]) -> ct.NonlinearIOSystem:
    """A block of which only the ports are drawn, with the sizes of its signals."""

    def signals(sizes: Mapping[str, int]) -> list[str]:
        return [f"{each}[{k}]" if size > 1 else each for each, size in sizes.items() for k in range(size)]

    count = sum(outputs.values())
    return ct.nlsys(
        None, lambda t, x, u, params: np.zeros(count), inputs=signals(inputs), outputs=signals(outputs),
        name=name,
    )  # fmt: skip


def _loop(
    name: str,
    parts: Sequence[ct.InputOutputSystem],
    pairs: Sequence[tuple[str, str]],
    inputs: Sequence[str],
    output: str,
    channels: int,
) -> ct.InterconnectedSystem:
    """Blocks wired target from source, channel by channel, with inputs of three channels."""
    free = [f"{each}[{k}]" for each in inputs for k in range(3)]
    shown = [f"{output}[{k}]" for k in range(channels)]
    wires = [[f"{target}[{k}]", f"{source}[{k}]"] for target, source in pairs for k in range(channels)]
    return ct.interconnect(
        parts,
        connections=wires,
        inplist=free,
        inputs=[each.partition(".")[2] for each in free],
        outlist=shown,
        outputs=[each.partition(".")[2] for each in shown],
        name=name,
    )


def pi_loop() -> pf.Drawing:
    """The loop of the docstring of ``draw``."""
    C, P = _tf([2.0, 1.0], [1.0, 0.0], "e", "u", "PI"), _tf([4.0], [1.0, 2.0], "u", "y", "plant")
    error = ct.summing_junction(["r", "-y"], "e", name="error")
    return pf.draw(ct.interconnect([error, C, P], inputs="r", outputs="y"))


def servo() -> pf.Drawing:
    """A motor inside a speed loop, opened."""
    motor = ct.interconnect(
        [
            ct.summing_junction(["v", "-b"], "w", name="emf"),
            _tf([1.0], [0.01, 1.0], "w", "i", "coil"),
            _tf([1.0], [0.1, 0.02], "i", "omega", "rotor"),
            _tf([0.05], [1.0], "omega", "b", "k_e"),
        ],
        inputs="v",
        outputs="omega",
        name="motor",
    )
    error = ct.summing_junction(["r", "-omega"], "e", name="error")
    law = _tf([2.0, 1.0], [1.0, 0.0], "e", "v", "PI")
    return pf.draw(ct.interconnect([error, law, motor], inputs="r", outputs="omega"), depth=1)


def speed_loop() -> pf.Drawing:
    """The PI speed loop with the observer that is told the command."""
    parts = [
        ct.summing_junction(["r", "-omega"], "e", name="error"),
        _tf([1.6, 32.0], [1.0, 0.0], "e", "u", "PI"),
        ct.summing_junction(["u", "-f_hat"], "tau", name="command"),
        _tf([1.0], [0.004, 1.0], "tau", "i", "current"),
        pf.transport_delay(["i"], 0.002, outputs=["tau_m"], name="delay"),
        ct.summing_junction(["tau_m", "f"], "load", name="torques"),
        _tf([1.0], [0.02, 0.0], "load", "omega", "rotor"),
    ]
    sampled = pf.lowpass(1, 60.0).sampled(0.001)
    observer = pf.sampled_block(sampled, channels=1, name="observer", inertia=0.02, f_theta=False)
    wires = [
        ["error.omega", "rotor.omega"], ["PI.e", "error.e"], ["command.u", "PI.u"],
        ["command.f_hat", "observer.f_hat[0]"], ["current.tau", "command.tau"], ["delay.i", "current.i"],
        ["torques.tau_m", "delay.tau_m"], ["rotor.load", "torques.load"], ["observer.x[0]", "rotor.omega"],
        ["observer.g[0]", "command.tau"],
    ]  # fmt: skip
    loop = ct.interconnect(
        [*parts, observer], connections=wires, inplist=["error.r", "torques.f"], inputs=["r", "f"],
        outlist=["rotor.omega"], outputs=["omega"], name="speed_loop",
    )  # fmt: skip
    return pf.draw(loop, below=["observer"])


def thermostat() -> pf.Drawing:
    """A relay that remembers, and the room that it heats."""
    relay = ct.nlsys(
        lambda t, x, u, params: [0.0], lambda t, x, u, params: [x[0]], inputs="T", outputs="heat", states="on",
        params={"low": 18.0, "high": 22.0}, name="relay",
    )  # fmt: skip
    cold = pf.event(
        lambda t, x, u, p: u[0] - p["low"], lambda t, x, u, p: [1.0], direction="falling", name="cold"
    )
    warm = pf.event(
        lambda t, x, u, p: u[0] - p["high"], lambda t, x, u, p: [0.0], direction="rising", name="warm"
    )
    room = _tf([1.0], [600.0, 1.0], "q", "T", "room")
    parts = [
        pf.hybrid(relay, [cold, warm]), _tf([30.0], [1.0], "heat", "warmth", "heater"),
        ct.summing_junction(["warmth", "outside"], "q", name="sum"), room
    ]  # fmt: skip
    return pf.draw(
        ct.interconnect(parts, inputs="outside", outputs="T", name="thermostat"), below=["relay", "heater"]
    )


def autopilot() -> pf.Drawing:
    """Where the filter of an export stands in a vehicle."""
    filter = pf.lowpass(2, 20.0, family="butterworth").sampled(0.004)
    parts = [
        _box("controller", {"setpoint": 3, "v": 3, "f_hat": 3}, {"thrust": 3}),
        _box("vehicle", {"thrust": 3, "f": 3}, {"v": 3}),
        pf.sampled_block(filter, channels=3, name="wind", inertia=1.5, f_theta=False),
    ]
    pairs = [
        ("controller.v", "vehicle.v"), ("controller.f_hat", "wind.f_hat"), ("vehicle.thrust", "controller.thrust"),
        ("wind.x", "vehicle.v"), ("wind.g", "controller.thrust"),
    ]  # fmt: skip
    loop = _loop("autopilot", parts, pairs, ("controller.setpoint", "vehicle.f"), "vehicle.v", 3)
    return pf.draw(loop, below=["wind"])


def quadruped() -> pf.Drawing:
    """The joint loop under the policy: twelve joints, 47 observations."""
    filter = pf.PhyFilter([1.0]).sampled(0.005, limit=20.0)
    parts = [
        _box("policy", {"command": 3, "q": 12, "q_rate": 12}, {"q_d": 12}),
        _box("PD", {"q_d": 12, "q": 12, "q_rate": 12, "f_hat": 12}, {"tau": 12}),
        _box("robot", {"tau": 12, "load": 3}, {"q": 12, "q_rate": 12}),
        _box("known", {"tau": 12, "q_rate": 12}, {"g": 12}),
        pf.sampled_block(filter, channels=12, name="filter", inertia=0.1, f_theta=False),
    ]
    pairs = [
        ("policy.q", "robot.q"), ("policy.q_rate", "robot.q_rate"), ("PD.q_d", "policy.q_d"), ("PD.q", "robot.q"),
        ("PD.q_rate", "robot.q_rate"), ("PD.f_hat", "filter.f_hat"), ("robot.tau", "PD.tau"), ("known.tau", "PD.tau"),
        ("known.q_rate", "robot.q_rate"), ("filter.x", "robot.q_rate"), ("filter.g", "known.g"),
    ]  # fmt: skip
    loop = _loop("quadruped", parts, pairs, ("policy.command", "robot.load"), "robot.q", 12)
    return pf.draw(loop, below=["filter", "known"])


def humanoid() -> pf.Drawing:
    """The regulator that leans: twin, residual, filter, posture."""
    rows, state, motors = 27, 54, 21
    parts = [
        _box("LQR", {"u_star": motors, "x_star": state, "x": state}, {"u": motors}),
        _box("robot", {"u": motors, "F": 1}, {"x": state}),
        _box("twin", {"u": motors, "x": state}, {"v_twin": rows}),
        _box("residual", {"x": state, "v_twin": rows}, {"r": rows}),
        ct.ss(
            -3.0 * np.eye(rows), 3.0 * np.eye(rows), np.eye(rows), 0.0, inputs=[f"r[{k}]" for k in range(rows)],
            outputs=[f"f_hat[{k}]" for k in range(rows)], name="filter",
        ),
        _box("hand", {"f_hat": rows, "x": state}, {"F_hat": 1}),
        _box("posture", {"F_hat": 1}, {"u_star": motors, "x_star": state}),
    ]  # fmt: skip
    loop = ct.interconnect(parts, inputs=["F"], outputs=[f"x[{k}]" for k in range(state)], name="humanoid")
    return pf.draw(loop, below=["twin", "residual", "filter", "hand"])


def _model(name: str) -> pf.Drawing:
    return pf.draw(models.load(name).build())


def _everyday(name: str) -> pf.Drawing:
    loop = importlib.import_module(f"phyfilter_ctl.models.everyday.{name}").loop()
    return pf.draw(loop, below=["filter", *(["model"] if name == "two_link_arm" else [])])


DRAWINGS: dict[str, Callable[[], pf.Drawing]] = {
    "loop": lambda: pf.draw(pf.lowpass(2, 20.0, family="butterworth")),
    "pi_loop": pi_loop,
    "servo": servo,
    "speed_loop": speed_loop,
    "thermostat": thermostat,
    "autopilot": autopilot,
    "acceleration": partial(_model, "acceleration"),
    "drone": partial(_model, "drone"),
    "aerial_manipulator": partial(_model, "aerial_manipulator"),
    "quadruped": quadruped,
    "humanoid": humanoid,
    "dc_motor": partial(_everyday, "dc_motor"),
    "pendulum": partial(_everyday, "pendulum"),
    "two_link_arm": partial(_everyday, "two_link_arm"),
    "differential_drive": partial(_everyday, "differential_drive"),
    "vertical_axis": partial(_everyday, "vertical_axis"),
}


def write(folder: Path = FOLDER) -> None:
    """Draw all; a file that would stay the same is left alone."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in DRAWINGS.items():
        place, svg = folder / f"{name}.svg", draw().svg
        if not place.is_file() or place.read_text(encoding="utf-8") != svg:
            place.write_text(svg, encoding="utf-8")


if __name__ == "__main__":
    write()
