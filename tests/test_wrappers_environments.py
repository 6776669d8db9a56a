"""Gymnasium: wrapped environments, one and many, do what the loop by hand does, through every kind of reset."""

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.wrappers import FeedForward, LoopModel

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed: extra gymnasium")
from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import AutoresetMode, SyncVectorEnv  # noqa: E402

from phyfilter_ctl.wrappers.environments import FeedForwardEnv, FeedForwardVectorEnv  # noqa: E402

H = 0.05


def pendulum_model():
    """Pendulum-v1: M theta'' = m g l / 2 sin(theta) + u, with m = l = 1 and g = 10."""
    return LoopModel(
        x=lambda y: [y[2]],
        g=lambda y, u: 5.0 * y[1] + u,
        compensate=lambda y, f_hat: -f_hat,
        inertia=lambda y: 1.0 / 3.0,
        low=-2.0,
        high=2.0,
    )


def feedforward():
    return FeedForward(PhyFilter([8.0]).sampled(H).live(1), pendulum_model())


def made(mass=1.0, steps=200):
    env = gymnasium.make("Pendulum-v1", max_episode_steps=steps)
    env.unwrapped.m = mass
    return env


def test_an_environment_is_the_loop_by_hand():
    ours, by_hand, loop = FeedForwardEnv(made(1.3), feedforward(), dt=H), made(1.3), feedforward()
    for seed, steps in ((1, 2), (2, 30), (3, 30)):  # the first ends within the longest gap
        y, info = ours.reset(seed=seed)
        expected, _ = by_hand.reset(seed=seed)
        loop.reset()
        np.testing.assert_array_equal(info["f_hat"], [0.0])
        for k in range(steps):
            action = np.array([np.sin(0.3 * k)], dtype=np.float32)
            sent = loop(k * H, expected.astype(float), action)
            y, reward, *_, info = ours.step(action)
            expected, wanted, *_ = by_hand.step(sent.astype(np.float32))
            np.testing.assert_array_equal(y, expected)
            assert reward == wanted
        assert info["f_hat"][0] != 0.0


@pytest.mark.filterwarnings("ignore::UserWarning")  # advice about names and scales
def test_it_is_an_environment_by_gymnasiums_own_check():
    env = FeedForwardEnv(made(), feedforward(), dt=H, observe=True)
    assert env.observation_space.shape == (4,)
    check_env(env, skip_render_check=True)


def test_intervals_and_spaces_that_do_not_fit_are_refused():
    with pytest.raises(
        ValueError, match=r"a step of the environment is 0.02 s, the filter is sampled at 0.05 s"
    ):
        FeedForwardEnv(made(), feedforward(), dt=0.02)
    with pytest.raises(TypeError, match="expected observations of one row of numbers"):
        FeedForwardEnv(gymnasium.make("Blackjack-v1"), feedforward(), dt=H, observe=True)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_many_are_each_alone(mode):
    """Episodes of 7 and 10 steps that end and begin at other times."""
    masses, lengths = (1.0, 1.3), (7, 10)
    both = SyncVectorEnv(
        [lambda m=m, n=n: made(m, n) for m, n in zip(masses, lengths, strict=True)], autoreset_mode=mode
    )
    ours = FeedForwardVectorEnv(both, feedforward, dt=H)
    alone = [FeedForwardEnv(made(m, n), feedforward(), dt=H) for m, n in zip(masses, lengths, strict=True)]
    y, info = ours.reset(seed=5)
    rows = [env.reset(seed=5 + i) for i, env in enumerate(alone)]
    ended = np.zeros(2, dtype=bool)
    for k in range(25):
        actions = np.array([[np.sin(0.3 * k)], [0.5]], dtype=np.float32)
        if mode == AutoresetMode.DISABLED and ended.any():
            y, info = ours.reset(options={"reset_mask": ended})
            rows = [env.reset() if ended[i] else rows[i] for i, env in enumerate(alone)]
        y, _, _, truncated, info = ours.step(actions)
        for i, env in enumerate(alone):
            if mode == AutoresetMode.NEXT_STEP and ended[i]:
                rows[i] = env.reset()
                continue
            *_, over, _ = step = env.step(actions[i])
            assert over == truncated[i]
            rows[i] = env.reset() if over and mode == AutoresetMode.SAME_STEP else (step[0], step[-1])
        ended = truncated
        np.testing.assert_array_equal(y, [row[0] for row in rows])
        np.testing.assert_array_equal(info["f_hat"], [row[1]["f_hat"] for row in rows])
