"""A torque at its limit: what is kept of its direction, and of the forces."""

from hypothesis import given
from hypothesis import strategies as st
from multicontact_control.control.law import finish_torque
from multicontact_control.control.tasks import MotionReading
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
from multicontact_control.records import JOINT, LAW
import numpy as np
import pytest

ALONG_X = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def limited(torque, priority, limit, least_share=0.0, added=0.0):
    joints = np.zeros(len(torque), dtype=JOINT)
    joints['torque'], joints['priority'], joints['torque_limit'] = torque, priority, limit
    joints['added'] = added
    law = np.zeros(1, dtype=LAW)
    law['least_share'] = least_share
    was_limited = finish_torque(law[0], joints)
    return joints['torque'], was_limited


@given(seed=st.integers(0, 2 ** 32 - 1), size=st.floats(0.1, 30.0))
def test_torque_beyond_its_limits_keeps_its_direction(seed, size):
    random = np.random.default_rng(seed)
    limit = random.uniform(5.0, 20.0, 6)
    priority = random.uniform(-0.9, 0.9, 6) * limit
    torque = priority + size * random.normal(size=6)
    found, was_limited = limited(torque, priority, limit)
    assert was_limited == bool((np.abs(torque) > limit).any())
    if not was_limited:
        np.testing.assert_array_equal(found, torque)
        return
    assert (np.abs(found) <= limit).all()
    share = (found - priority) / (torque - priority)
    np.testing.assert_allclose(share, share[0], atol=1e-9)
    assert 0.0 <= share[0] < 1.0
    assert (np.abs(found) / limit).max() == pytest.approx(1.0)


def test_what_cannot_be_carried_is_cut_and_the_rest_left_alone():
    found, _ = limited([12.0, 3.0], [11.0, 1.0], [10.0, 10.0])
    np.testing.assert_array_equal(found, [10.0, 3.0])
    found, _ = limited([9.0, 20.0], [1.0, 0.0], [10.0, 4.0], 0.5)
    np.testing.assert_array_equal(found, [5.0, 4.0])
    found, _ = limited([np.nan, 30.0], [0.0, 0.0], [10.0, 10.0])
    assert np.isnan(found[0])


def test_limits_are_those_of_the_command_where_the_drives_add_something():
    found, was_limited = limited([20.0, 3.0], [11.0, 1.0], [10.0, 10.0], added=[5.0, 0.0])
    np.testing.assert_allclose(found, [15.0, 1.0 + 2.0 * 4.0 / 9.0])
    assert was_limited
    found, was_limited = limited([14.0, -6.0], [0.0, 0.0], [10.0, 10.0], added=[5.0, 4.0])
    np.testing.assert_array_equal(found, [14.0, -6.0])
    assert not was_limited


def sliding_errors():
    """Return the rms and the largest error of the forces while joint 1 has too little torque."""
    loop, errors = ClosedLoop(resolve('quick', plant='rigid', controller={
        'torque_limit': [3.35, 186.4, 89.4, 24.2, 20.1, 21.3],
        'collision': {'threshold': [1e9] * 6}}), commanded=True), []
    rate = np.pi  # rad/s
    try:
        loop.advance()
        loop.control.set_forces({'table': 10.0, 'board': 10.0})
        for _ in range(2000):
            loop.advance()
        start = loop.control.output.pose
        for k in range(1, 2001):
            time = rate * 0.002 * k
            loop.control.set_motion(MotionReading(
                start.position_world + [0.05 * (1.0 - np.cos(time)), 0.0, 0.0],
                start.quaternion_xyzw, 0.05 * rate * np.sin(time) * ALONG_X,
                0.05 * rate ** 2 * np.cos(time) * ALONG_X))
            loop.advance()
            errors.append(np.abs(loop.true_forces - 10.0))
        assert loop.control.events.limited['torque'] > 500
    finally:
        loop.close()
    return np.sqrt(np.mean(np.square(errors), axis=0)), np.max(errors, axis=0)


@pytest.mark.slow
def test_forces_are_kept_better_than_by_cutting_one_joint(monkeypatch):
    """Cut in joint 1 alone, the motion that is left turns into the board."""
    rms, largest = sliding_errors()
    monkeypatch.setattr('multicontact_control.control.controller.LEAST_TASK_SHARE', 1.0)
    cut_rms, cut_largest = sliding_errors()
    assert rms[1] < 0.85 * cut_rms[1]
    assert largest.max() < 0.95 * cut_largest.max()
