"""What is learnt of surfaces: when a normal is turned, and where to."""

from multicontact_control.contact.surfaces import follow_surfaces
from multicontact_control.records import CONTACT, FRAME
import numpy as np
import pytest

TILT = np.radians(20.0)
TRUE_NORMAL = np.array([np.sin(TILT), 0.0, -np.cos(TILT)])
DOWNHILL = np.array([np.cos(TILT), 0.0, np.sin(TILT)])


def follow(velocity, ticks=1):
    """Return the normal after samples of 10 N on a tilted surface that rubs with 1 N."""
    frame, contacts = np.zeros(1, dtype=FRAME), np.zeros(1, dtype=CONTACT)
    frame['rotation'] = np.eye(3)
    frame['twist'][0, :3] = velocity
    configured = np.array([0.0, 0.0, -1.0])
    config = contacts['config']
    contacts['normal'] = config['normal'] = configured
    contacts['answer']['active'], config['normal_gain'] = True, 0.1
    config['turn_limit'], config['smallest_cosine'] = 0.1, np.cos(0.6)
    for _ in range(ticks):
        normal = contacts['normal'][0]
        force = 10.0 * TRUE_NORMAL + velocity / max(np.linalg.norm(velocity), 1e-9)
        contacts['alpha_meas'] = force @ normal
        contacts['friction'] = force - (force @ normal) * normal
        follow_surfaces(frame[0], contacts)
    return contacts['normal'][0]


@pytest.mark.parametrize('velocity', [
    0.05 * DOWNHILL, -0.05 * DOWNHILL, [0.0, 0.05, 0.0], 0.04 * DOWNHILL + [0.0, 0.04, 0.0]])
def test_normal_follows_the_surface_that_is_slid_along(velocity):
    np.testing.assert_allclose(follow(np.array(velocity), ticks=300), TRUE_NORMAL, atol=1e-9)


@pytest.mark.parametrize('velocity', [
    0.02 * DOWNHILL,  # too slow to have a direction
    0.2 * TRUE_NORMAL, -0.2 * TRUE_NORMAL, [0.0, 0.0, 0.1], [0.05, 0.0, 0.1]])  # bounces
def test_normal_stays_without_sliding(velocity):
    assert (follow(np.array(velocity)) == [0.0, 0.0, -1.0]).all()
