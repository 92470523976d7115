"""The reference around a task: box, reach, pauses."""

from arms import controller_config
from equations import rotation_error
from multicontact_control.control.reference import CommandedReference
from multicontact_control.dynamics.pose import Pose
from multicontact_control.supervision.contacts import ContactState
from multicontact_control.supervision.reference import ContactReference
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

NORMALS = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
POSE = Pose(np.array([0.0, 0.55, 0.64]), np.eye(3))
STILL = np.zeros(6)


def make(**limits):
    config = controller_config(limits=limits)
    task = CommandedReference(config.contact_names)
    reference = ContactReference(config, task)
    reference.start(POSE, NORMALS)
    reference.observe(POSE, STILL)
    return reference, task


def gap(pose):
    return np.concatenate([pose[0] - POSE[0], rotation_error(pose[1], POSE[1])])


def test_pose_outside_the_box_is_not_asked_for():
    reference, task = make(operational_speed=10.0)
    task.set_motion(np.array([0.0, 5.0, -5.0]), np.array([0, 0, 0, 1.0]), np.ones(6), STILL)
    reference.observe(Pose(np.array([0.0, 0.8, 0.4]), np.eye(3)), STILL)
    out = reference.update(0.0, np.zeros(2))
    np.testing.assert_allclose(out.pose_des.position_world, [0.0, 0.9, 0.3])
    np.testing.assert_array_equal(out.twist_des[1:3], 0.0)
    assert out.twist_des[0] == 1.0
    assert reference.limited


def test_turn_asked_for_is_within_reach():
    reference, task = make(operational_turn=1.0)
    task.set_motion(POSE.position_world, np.array([1.0, 0, 0, 0]), STILL, STILL)
    out = reference.update(0.0, np.zeros(2))
    turn = rotation_error(out.pose_des.rotation_world, POSE.rotation_world)
    assert np.linalg.norm(turn) == pytest.approx(2.0 / 30.0)


def test_contact_that_was_let_go_to_stand_still_is_sought_again_for_the_same_task():
    reference, commanded = make()
    commanded.set_forces({'table': 5.0})
    for _ in range(2):
        reference.update(0.0, np.zeros(2))
        assert reference.state_names == ('approaching', 'free')
        reference.stand_still(POSE)
        assert reference.state_names == ('free', 'free')


@pytest.mark.parametrize(('away', 'speed'), [
    (Pose(POSE.position_world + [0.05, 0.0, 0.0], np.eye(3)), 0.1),
    (Pose(POSE.position_world, Rotation.from_rotvec([0.0, 0.3, 0.0]).as_matrix()), 0.4)])
def test_task_is_caught_up_with_slowly_after_a_pause(away, speed):
    """The reference starts where the arm is, and comes back below a fifth of the speed limit."""
    reference, _ = make()
    reference.update(0.0, np.zeros(2))
    reference.observe(away, STILL)
    reference.resume()
    gaps = []
    for k in range(1, 2500):
        pose = reference.update(k * 0.002, np.zeros(2)).pose_des
        reference.observe(pose, STILL)
        gaps.append(gap(pose))
    np.testing.assert_allclose(gaps[0], gap(away), atol=2e-3)
    assert np.abs(np.diff(gaps, axis=0)).max() <= speed * 0.002 + 1e-9
    assert np.abs(gaps[-1]).max() < 1e-4


def test_contact_that_leads_out_of_the_workspace_is_left_and_not_taken_up_again():
    reference, task = make()
    task.set_forces({'table': 10.0})
    felt = np.array([5.0, 0.0])
    for k in range(100):
        reference.update(k * 0.002, felt)
    assert reference.states[0] is ContactState.HOLDING
    reference.lead_back()
    for k in range(100, 1500):
        out = reference.update(k * 0.002, felt)
        assert not out.active.any()
    assert reference.states[0] is ContactState.GIVEN_UP
    reference.seek_again()
    for k in range(1500, 1600):
        reference.update(k * 0.002, felt)
    assert reference.states[0] is ContactState.HOLDING


@pytest.mark.parametrize(('axis', 'lead'), [(0, 'reach'), (4, 'turn')])
def test_twist_that_leads_beyond_the_limits_does_not_count(axis, lead):
    """With an error of three quarters of the reach a quarter of the speed is left."""
    reference, task = make(operational_speed=0.5, operational_turn=0.5)
    length = 0.5 * 2.0 / 30.0  # k_v / k_p = 2 / omega
    position, quaternion = POSE.position_world.copy(), np.array([0, 0, 0, 1.0])
    if lead == 'reach':
        position[0] += 0.75 * length
    else:
        quaternion = np.array([0.0, np.sin(0.375 * length), 0.0, np.cos(0.375 * length)])
    for speed, counts in ((0.12, True), (0.13, False), (11.0, False), (-0.8, True)):
        twist = np.zeros(6)
        twist[axis] = speed
        task.set_motion(position, quaternion, twist, 0.5 * twist)
        out = reference.update(0.0, np.zeros(2))
        assert out.twist_des[axis] == (speed if counts else 0.0)
        assert out.acceleration_des[axis] == (0.5 * speed if counts else 0.0)
        assert reference.limited is not counts
