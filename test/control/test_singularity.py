"""Passing through the PUMA's singularities: torques without a spike, gravity held throughout."""

from arms import controller_config, HOME, Law, Measurement
from multicontact_control.control.tasks import Task
from multicontact_control.dynamics.operational_space import mobility_and_inertia
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.paths import config_dir
import numpy as np
import pytest

H = 0.002


class Follow:
    """Asks for the pose the arm is in, a little beside it, and for the speed it has."""

    contact_state = {}

    def __init__(self, offset):
        self.offset = np.array(offset)

    def start(self, pose, normals_world):
        pass

    def task(self, time, alpha_meas=None):
        pose, twist = self.now
        beside = type(pose)(pose.position_world + self.offset, pose.rotation_world)
        return Task(beside, twist, np.zeros(6), np.zeros(2, dtype=bool), np.zeros(2))


def torques(joint, start, end, offset, seconds=1.0, **limits):
    """Return torque over limit along a path of one joint, with its gravity share."""
    config = controller_config(torque_limit=[], limits={'torque_rate': [], **limits})
    robot = RobotModel(config.robot, config_dir())
    follow = Follow(offset)
    controller = Law(config, follow)
    speed = np.zeros(6)
    speed[joint] = (end - start) / seconds
    limit = np.array(controller_config().torque_limit)
    found, gravity = [], []
    for k in range(round(seconds / H) + 1):
        q = HOME.copy()
        q[joint] = start + speed[joint] * k * H
        state = robot.update(q, speed)
        follow.now = state.pose, state.twist_world
        found.append(controller.step(
            Measurement(k * H, q, speed, np.zeros(6)), np.full(2, 0.6)).torque / limit)
        gravity.append((state.gravity + state.coriolis) / limit)
    return np.array(found), np.array(gravity)


@pytest.mark.parametrize('offset', [(1e-3, 0, 0), (0, 1e-3, 0), (0, 0, 1e-3), (0, 0, 0)])
@pytest.mark.parametrize(('joint', 'start', 'end'), [(4, -0.5, 0.5), (2, 2.2, 1.0)])
def test_no_spike_on_the_way_through_wrist_and_elbow_singularity(joint, start, end, offset):
    """Within 40 % of the limits beside gravity, and no more than 2 % of them from tick to tick."""
    found, gravity = torques(joint, start, end, offset)
    assert np.isfinite(found).all()
    assert np.abs(found - gravity).max() < 0.4
    assert np.abs(np.diff(found, axis=0)).max() < 0.02


def test_damping_is_smooth_bounded_and_absent_away_from_singularities():
    """Lambda = 1 / (e + d): at most 2 / e_0; d and its slope go to zero at e_0."""
    e = np.linspace(0.0, 0.02, 2001)
    damped, room = np.empty_like(e), [np.empty((6, 6)) for _ in range(4)]
    for i, smallest in enumerate(e):
        J = np.diag(np.sqrt([smallest, 1.0, 1.0, 1.0, 1.0, 1.0]))
        assert mobility_and_inertia(
            np.asfortranarray(np.eye(6)), np.asfortranarray(J), 0.01, *room) >= 0.0
        damped[i] = 1.0 / room[3][0, 0]
    assert (1.0 / damped).max() <= 2.0 / 0.01 + 1e-9
    np.testing.assert_allclose(damped[e >= 0.01], e[e >= 0.01], rtol=1e-12)
    assert np.abs(np.diff(damped, 2)).max() < 2e-8
