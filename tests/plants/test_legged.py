"""Priors of joint torques: closed forms, and what they refuse."""

import numpy as np
import pytest

from phyfilter_ctl.plants.legged import JointQuantities, JointSpacePrior, balanced_contact

FREE = JointSpacePrior(bias="none", contact="omitted")
GOOD = JointQuantities(np.zeros(2), M=np.eye(2), bias=np.zeros(2))


def random_inertia(rng, *shape):
    A = rng.standard_normal(shape)
    return A @ np.swapaxes(A, -1, -2) + shape[-1] * np.eye(shape[-1])


def test_floating_base_is_the_rows_of_the_inverse():
    """With f on the joints alone, q'' of the whole system is that of the eliminated one: solved both ways."""
    rng = np.random.default_rng(5)
    M = random_inertia(rng, 7, 9, 9)
    bias, contact = rng.standard_normal((2, 7, 9))
    torque, f = rng.standard_normal((2, 7, 3))
    forces = contact - bias + np.concatenate([np.zeros((7, 6)), torque + f], axis=-1)
    acceleration = np.linalg.solve(M, forces[..., None])[..., 6:, 0]
    now = JointQuantities(np.zeros((7, 3)), M, bias, contact)
    prior = JointSpacePrior(base="floating")
    residual = (prior.inertia_matrix(now) @ acceleration[..., None])[..., 0] - prior.known_torque(now, torque)
    np.testing.assert_allclose(residual, f, atol=1e-11)
    fixed = JointSpacePrior()
    np.testing.assert_array_equal(fixed.inertia_matrix(now), M[:, 6:, 6:])


def test_balanced_contact_carries_the_base_with_least_force():
    rng = np.random.default_rng(6)
    J, bias = rng.standard_normal((5, 4, 3, 18)), rng.standard_normal((5, 18))
    standing = np.array([[1, 1, 1, 1], [1, 1, 0, 1], [0, 1, 1, 0], [1, 0, 0, 1], [1, 1, 1, 0]], dtype=float)
    torque = balanced_contact(bias, J, standing)
    np.testing.assert_allclose(torque[:, :6], bias[:, :6], atol=1e-10)
    for k in range(5):
        rows = J[k][standing[k] > 0].reshape(-1, 18)
        force, *_ = np.linalg.lstsq(rows[:, :6].T, bias[k, :6], rcond=None)  # minimum norm by another routine
        np.testing.assert_allclose(torque[k], rows.T @ force, atol=1e-10)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: JointSpacePrior(inertia="banded"), "inertia: expected one of full, diagonal, constant"),
        (lambda: JointSpacePrior(inertia="constant"), "constant_inertia goes with"),
        (lambda: JointSpacePrior(inertia="constant", constant_inertia=[1.0, -1.0]), "positive definite"),
        (
            lambda: JointSpacePrior(inertia="constant", constant_inertia=[[1.0, 2.0], [2.0, 1.0]]),
            "positive definite",
        ),
        (lambda: JointSpacePrior(inertia="diagonal", base="floating"), "full inertia"),
        (lambda: JointSpacePrior(damping=-1.0), "damping: expected 0"),
        (lambda: JointQuantities(np.zeros(2), M=np.eye(3)[:2]), "M: expected shape"),
        (
            lambda: JointQuantities(np.zeros(2), M=np.eye(2), bias=np.zeros(3)),
            "same number of degrees of freedom",
        ),
        (lambda: JointQuantities(np.zeros(4), bias=np.zeros(3)), "at least as many"),
        (lambda: FREE.inertia_matrix(JointQuantities(np.zeros(2))), "needs the quantity M, which is missing"),
        (
            lambda: FREE.inertia_matrix(JointQuantities(np.zeros(2), M=np.diag([1.0, -1.0]))),
            "positive definite",
        ),
        (
            lambda: FREE.inertia_matrix(JointQuantities(np.zeros(2), M=np.full((2, 2), np.nan))),
            "positive definite",
        ),
        (lambda: JointSpacePrior(contact="estimated").known_torque(GOOD, [0.0, 0.0]), "contact_estimate"),
        (lambda: FREE.known_torque(GOOD, [0.0, 0.0, 0.0]), "torque: expected shape"),
        (lambda: balanced_contact(np.zeros(18), np.zeros((4, 3, 17)), np.ones(4)), "expected bias"),
        (lambda: balanced_contact(np.zeros(18), np.zeros((4, 3, 18)), 2.0 * np.ones(4)), "standing"),
    ],
)
def test_wrong_input_says_so(build, words):
    with pytest.raises(ValueError, match=words):
        build()
