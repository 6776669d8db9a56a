"""A robot drawn off screen, where the machine can."""

from __future__ import annotations

import numpy as np
import pytest

from phyfilter_ctl.plants.legged import Camera, renderer

mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: nothing is drawn")

BALL = """<mujoco><worldbody><body>
<freejoint/><geom type="sphere" size="0.2" rgba="1 0 0 1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("at", [None, (0.0, 0.0, 0.0)])
def test_camera_follows_the_base_or_stays(at: tuple[float, float, float] | None) -> None:
    model = mujoco.MjModel.from_xml_string(BALL)
    here, aside = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.5, 0.0, 1.0, 0.0, 0.0, 0.0])
    try:
        with renderer(model, (64, 48), Camera(2.0, 180.0, 0.0, at, plain=True)) as draw:
            first, second = draw(here), draw(aside)
    except Exception as error:
        pytest.skip(f"nothing to draw with: {error}")
    assert first.shape == (48, 64, 3)
    red = [np.argwhere((frame[..., 0] > 60) & (frame[..., 1] < 60))[:, 1].mean() for frame in (first, second)]
    assert abs(red[0] - 31.5) < 1.5
    assert (abs(red[1] - red[0]) < 1.5) == (at is None)
