"""Every convention of a vector and an attitude, against rotations of scipy."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phyfilter_ctl import learned
from phyfilter_ctl.robot.frames import attitude, rotated, to_internal
from tests.robot.flight import log_of

# Columns: the axes of a frame in ENU or FLU.
AXES = {
    "ENU": np.eye(3),
    "NED": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]),
    "NWU": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "FLU": np.eye(3),
    "FRD": np.diag([1.0, -1, -1]),
}
TRUE = Rotation.random(50, rng=np.random.default_rng(0))  # FLU to ENU
V = np.random.default_rng(1).standard_normal((50, 3))


@pytest.mark.parametrize("frame", AXES)
def test_vectors_come_into_enu_and_flu(frame):
    np.testing.assert_array_equal(to_internal(V @ AXES[frame], frame), V)


@pytest.mark.parametrize("kind", ["wxyz", "xyzw", "rpy"])
@pytest.mark.parametrize(("body", "world"), list(itertools.product(["FLU", "FRD"], ["ENU", "NED", "NWU"])))
@pytest.mark.parametrize("inverse", [False, True])
def test_attitudes_come_from_flu_to_enu(kind, body, world, inverse):
    logged = Rotation.from_matrix(AXES[world].T @ TRUE.as_matrix() @ AXES[body])
    logged = logged.inv() if inverse else logged
    if kind == "rpy":
        values = logged.as_euler("ZYX")[:, ::-1]
    else:
        values = logged.as_quat(scalar_first=kind == "wxyz") * np.where(np.arange(50) % 3, 1.0, -1.0)[:, None]
    q = attitude(values, kind, (world, body) if inverse else (body, world))
    np.testing.assert_allclose(rotated(q, V), TRUE.apply(V), atol=1e-14)
    assert np.all(np.sum(q[1:] * q[:-1], axis=1) >= 0.0)  # no jump from q to -q


def test_what_is_no_quaternion_is_refused():
    with pytest.raises(ValueError, match=r"expected quaternions of length 1, got 2 at sample 0 \(50 such\)"):
        attitude(2.0 * TRUE.as_quat(), "xyzw", ("FLU", "ENU"))


def test_a_learned_model_in_a_file_is_f_theta(load, tmp_path):
    z = np.linspace(-1.0, 1.0, 200)[:, None]
    model = learned.Chebyshev(degree=2, n_d=0).fit(z, 1.0 + z**2).model
    model.save(tmp_path / "drag.npz")
    t = 0.01 * np.arange(100)
    robot = load("""
format = "phyfilter-robot"
version = 1
signals.v = { field = "v", unit = "m/s" }
model = { x = "v", f_theta_file = "drag.npz", features = "[v]" }
""")
    v = np.sin(3.0 * t)
    log = robot.read(log_of("f.csv", {"table": (t, {"v": v})}))
    np.testing.assert_allclose(log.f_theta[:, 0], 1.0 + v**2, atol=1e-9)
    np.testing.assert_array_equal(log.features[:, 0], v)
