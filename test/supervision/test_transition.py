"""The blends of torques: continuous, of bounded rate, and gone in the end."""

from multicontact_control.config import TransitionConfig
from multicontact_control.supervision.transition import (
    ExponentialBlend,
    QuinticBlend,
)
import numpy as np
import pytest

H = 0.002
LAW = np.array([3.0, -40.0, 0.0])
START = np.array([1.0, 10.0, 0.0])


@pytest.mark.parametrize(('blend_time', 'torque_rate'), [
    (0.2, 1e6), (0.2, 100.0), (0.0, 100.0), (0.0, 1e9)])
def test_quintic_blend_starts_at_the_start_and_keeps_to_its_rate(blend_time, torque_rate):
    blend = QuinticBlend(TransitionConfig(blend_time=blend_time, torque_rate=torque_rate), H)
    assert blend.apply(LAW) is LAW
    blend.start(START)
    broken = np.full(3, np.nan)
    assert blend.apply(broken) is broken  # it waits for a number
    torques = [blend.apply(LAW)]
    while torques[-1] is not LAW:
        torques.append(blend.apply(LAW))
    np.testing.assert_array_equal(torques[0], START)
    assert torques[-1] is LAW
    assert np.abs(np.diff(torques, axis=0)).max() <= torque_rate * H * (1.0 + 1e-9)
    assert len(torques) - 1 >= blend_time / H
    assert (np.diff(torques, axis=0)[:, 1] <= 0.0).all()


def test_quintic_blend_lets_the_law_act_from_the_first_tick_on():
    """What the law adds later comes through at once: only the difference at the start fades."""
    blend = QuinticBlend(TransitionConfig(blend_time=1.0), H)
    blend.start(START)
    blend.apply(LAW)
    calm = blend.apply(LAW)
    blend.start(START)
    blend.apply(LAW)
    np.testing.assert_allclose(blend.apply(LAW + 5.0) - calm, 5.0)


def test_exponential_blend_is_continuous_and_decays_at_its_declared_rate():
    blend = ExponentialBlend(0.01, H)
    old, new = np.array([5.0, -3.0]), np.array([-1.0, 2.0])
    last = None
    for _ in range(3):
        last = blend.apply('old', old, last)
    out = [last]
    for _ in range(60):
        out.append(blend.apply('new', new, out[-1]))
    out = np.array(out)
    np.testing.assert_allclose(out[1], old)
    np.testing.assert_allclose(out[-1], new, atol=1e-4)
    assert (np.abs(np.diff(out, axis=0)) <= np.abs(old - new) * H / 0.01 + 1e-12).all()
