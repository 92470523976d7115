"""A torque at its limit: what is kept of its direction."""

from hypothesis import given
from hypothesis import strategies as st
from multicontact_control.control.law import finish_torque
from multicontact_control.records import JOINT, LAW
import numpy as np
import pytest


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


@pytest.mark.parametrize(('torque', 'priority', 'limit', 'options', 'expected'), [
    ([12.0, 3.0], [11.0, 1.0], [10.0, 10.0], {}, [10.0, 3.0]),  # more than can be carried
    ([9.0, 20.0], [1.0, 0.0], [10.0, 4.0], {'least_share': 0.5}, [5.0, 4.0]),
    ([np.nan, 30.0], [0.0, 0.0], [10.0, 10.0], {}, [np.nan, 10.0]),
    # Limits are those of command and torque that the drives add.
    ([20.0, 3.0], [11.0, 1.0], [10.0, 10.0], {'added': [5.0, 0.0]}, [15.0, 1.0 + 8.0 / 9.0]),
    ([14.0, -6.0], [0.0, 0.0], [10.0, 10.0], {'added': [5.0, 4.0]}, [14.0, -6.0])])
def test_torque_beyond_its_share_is_cut_joint_by_joint(
        torque, priority, limit, options, expected):
    np.testing.assert_allclose(limited(torque, priority, limit, **options)[0], expected)
