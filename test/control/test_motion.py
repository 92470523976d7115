"""The PD motion law (P04 sec. 3.1, 5.2)."""

from multicontact_control.config import MotionConfig
from multicontact_control.control.motion import motion_law
from multicontact_control.control.reference import Reference
from multicontact_control.dynamics.pose import Pose
from multicontact_control.records import FRAME, LAW, TASK
import numpy as np
import pytest

REST = np.zeros(6)


def motion_acceleration(config, reference, pose, twist):
    """Return what the compiled law makes of a reference."""
    law, task, frame = (np.zeros(1, dtype=kind) for kind in (LAW, TASK, FRAME))
    law['k_p'] = config.natural_frequency ** 2
    law['k_v'] = 2.0 * config.damping_ratio * config.natural_frequency
    task['position'], task['rotation'] = reference.pose_des
    task['twist'], task['acceleration'] = reference.twist_des, reference.acceleration_des
    frame['position'], frame['rotation'] = pose
    frame['twist'] = twist
    f_t = np.empty(6)
    motion_law(law[0], task[0], frame[0], f_t)
    return f_t


def _reference(position, acceleration=REST):
    return Reference(
        pose_des=Pose(position, np.eye(3)), twist_des=np.zeros(6), acceleration_des=acceleration,
        active=np.zeros(0, dtype=bool), alpha_des=np.zeros(0))


def test_motion_law_has_the_papers_gains():
    """30 rad/s, critically damped: k_p = 900, k_v = 60."""
    pose = Pose(np.zeros(3), np.eye(3))
    a = motion_acceleration(MotionConfig(), _reference(np.array([0.01, 0, 0])), pose, np.zeros(6))
    np.testing.assert_allclose(a, [9.0, 0, 0, 0, 0, 0])
    a = motion_acceleration(MotionConfig(), _reference(np.zeros(3)), pose, np.full(6, 0.1))
    np.testing.assert_allclose(a, -6.0)


def test_motion_law_is_critically_damped():
    """A double integrator under the law settles without overshoot, at 30 rad/s."""
    position, speed, h = 1.0, 0.0, 1e-4
    path = []
    for _ in range(5000):
        pose = Pose(np.array([position, 0, 0]), np.eye(3))
        a = motion_acceleration(MotionConfig(), _reference(np.zeros(3)), pose,
                                np.array([speed, 0, 0, 0, 0, 0]))[0]
        speed += h * a
        position += h * speed
        path.append(position)
    t = h * np.arange(1, 5001)
    expected = (1.0 + 30.0 * t) * np.exp(-30.0 * t)
    assert np.abs(np.array(path) - expected).max() < 5e-3
    assert min(path) > -1e-3


def test_motion_law_passes_the_commanded_acceleration_through():
    """Feed-forward."""
    feed = np.arange(6.0)
    a = motion_acceleration(MotionConfig(), _reference(np.zeros(3), feed),
                            Pose(np.zeros(3), np.eye(3)), np.zeros(6))
    np.testing.assert_allclose(a, feed)
    assert a is not feed


def test_motion_law_turns_back_to_the_commanded_orientation():
    """A rotation of 0.1 rad about z is answered by -90 rad/s^2."""
    c, s = np.cos(0.1), np.sin(0.1)
    pose = Pose(np.zeros(3), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]))
    a = motion_acceleration(MotionConfig(), _reference(np.zeros(3)), pose, np.zeros(6))
    assert a[5] == pytest.approx(-90.0)
