import pytest

from phyfilter_ctl import Robot

PX4 = """
format = "phyfilter-robot"
version = 1
preset = "px4-multirotor"
constants = { mass = 1.5, motor_thrust = 7.0 }
"""


@pytest.fixture
def load(tmp_path):
    """A robot from the text of its file."""

    def loaded(text: str) -> Robot:
        path = tmp_path / "robot.toml"
        path.write_text(text)
        return Robot.load(path)

    return loaded


@pytest.fixture
def px4(load):
    return load(PX4)
