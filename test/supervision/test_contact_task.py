"""The task around a source: box, reach, pauses, hold and lock."""

from types import SimpleNamespace

from arms import controller_config
from equations import rotation_error
from multicontact_control.contact.geometry import place_columns
from multicontact_control.control.tasks import (
    ApproachConfig,
    CommandedTask,
    MotionReading,
    ReferenceConfig,
    ScenarioTask,
    SineConfig,
)
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.records import CONTACT, CONTROL
from multicontact_control.supervision.contact_task import ContactTask
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

H = 0.002
POSE = Pose(np.array([0.0, 0.55, 0.64]), np.eye(3))
STILL = np.zeros(6)
AHEAD = np.array([0, 0, 0, 1.0])


class Asked:
    """A task and the records that it is written into, at a pose."""

    def __init__(self, source=None, *, guarded=True, locked=False, **limits):
        config = controller_config(limits=limits, sensor={'require_push_test': locked})
        self.source = source or CommandedTask(config.contact_names)
        self.controls, self.contacts = np.zeros(1, CONTROL), np.zeros(2, CONTACT)
        place_columns(config, self.contacts)
        self.task = ContactTask(config, self.source, self, guarded=guarded)
        self.stay(POSE)
        self.task.start(POSE)

    def stay(self, pose):
        self.controls['frame']['position'], self.controls['frame']['rotation'] = pose

    def move(self, *motion):
        self.source.set_motion(MotionReading(*motion), self.task.sought_normals())

    def ask(self, time, alpha_meas=(0.0, 0.0)):
        """Return what is asked for, beside measured forces."""
        self.contacts['alpha_meas'] = alpha_meas
        self.task.ask(time)
        task = self.controls['task'][0].copy()
        return SimpleNamespace(
            pose=Pose(task['position'], task['rotation']), twist=task['twist'],
            acceleration=task['acceleration'], active=self.contacts['answer']['active'].copy(),
            alpha_des=self.contacts['answer']['alpha_des'].copy())


def moving(names=('table', 'board')):
    config = ReferenceConfig(approach=ApproachConfig(start_time=100.0),
                             motion=SineConfig(start_time=0.0, amplitude=0.02))
    return ScenarioTask(config, rate=1.0 / H, names=names)


def gap(pose):
    return np.concatenate([pose[0] - POSE[0], rotation_error(pose[1], POSE[1])])


def test_task_keeps_the_pose_in_the_box_and_within_reach():
    asked = Asked(operational_speed=10.0, operational_turn=1.0)
    asked.move(np.array([0.0, 5.0, -5.0]), np.array([1.0, 0, 0, 0]), np.ones(6), STILL)
    asked.stay(Pose(np.array([0.0, 0.8, 0.4]), np.eye(3)))
    out = asked.ask(0.0)
    np.testing.assert_allclose(out.pose.position_world, [0.0, 0.9, 0.3])
    np.testing.assert_array_equal(out.twist[:3], [1.0, 0.0, 0.0])
    turn = rotation_error(out.pose.rotation_world, POSE.rotation_world)
    assert np.linalg.norm(turn) == pytest.approx(2.0 / 30.0)
    assert asked.task.limited


def test_contact_released_by_a_hold_is_sought_again_for_the_same_task():
    asked = Asked()
    asked.source.set_forces({'table': 5.0})
    for _ in range(2):
        asked.ask(0.0)
        assert asked.task.state_names == ('approaching', 'free')
        asked.task.hold(True)
        assert asked.task.state_names == ('free', 'free')
        asked.task.hold(False)


@pytest.mark.parametrize(('away', 'speed'), [
    (Pose(POSE.position_world + [0.05, 0.0, 0.0], np.eye(3)), 0.1),
    (Pose(POSE.position_world, Rotation.from_rotvec([0.0, 0.3, 0.0]).as_matrix()), 0.4)])
def test_task_is_caught_up_with_slowly_after_a_pause(away, speed):
    """It starts where the arm is, and comes back below a fifth of the speed limit."""
    asked = Asked()
    asked.ask(0.0)
    asked.stay(away)
    asked.task.resume()
    gaps = []
    for k in range(1, 2500):
        pose = asked.ask(k * H).pose
        asked.stay(pose)
        gaps.append(gap(pose))
    np.testing.assert_allclose(gaps[0], gap(away), atol=2e-3)
    assert np.abs(np.diff(gaps, axis=0)).max() <= speed * H + 1e-9
    assert np.abs(gaps[-1]).max() < 1e-4


def test_contact_that_leads_out_of_the_workspace_is_left_and_not_taken_up_again():
    asked, felt = Asked(), (5.0, 0.0)
    asked.source.set_forces({'table': 10.0})
    for k in range(100):
        asked.ask(k * H, felt)
    assert asked.task.state_names[0] == 'holding'
    asked.task.lead_back()
    for k in range(100, 1500):
        assert not asked.ask(k * H, felt).active.any()
    assert asked.task.state_names[0] == 'given up'
    asked.task.seek_again()
    for k in range(1500, 1600):
        asked.ask(k * H, felt)
    assert asked.task.state_names[0] == 'holding'


@pytest.mark.parametrize(('axis', 'lead'), [(0, 'reach'), (4, 'turn')])
def test_twist_that_leads_beyond_the_limits_does_not_count(axis, lead):
    """With an error of three quarters of the reach a quarter of the speed is left."""
    asked = Asked(operational_speed=0.5, operational_turn=0.5)
    length = 0.5 * 2.0 / 30.0  # k_v / k_p = 2 / omega
    position, quaternion = POSE.position_world.copy(), AHEAD
    if lead == 'reach':
        position[0] += 0.75 * length
    else:
        quaternion = np.array([0.0, np.sin(0.375 * length), 0.0, np.cos(0.375 * length)])
    for speed, counts in ((0.12, True), (0.13, False), (11.0, False), (-0.8, True)):
        twist = np.zeros(6)
        twist[axis] = speed
        asked.move(position, quaternion, twist, 0.5 * twist)
        out = asked.ask(0.0)
        assert out.twist[axis] == (speed if counts else 0.0)
        assert out.acceleration[axis] == (0.5 * speed if counts else 0.0)
        assert asked.task.limited is not counts


@pytest.mark.parametrize('way', ['hold', 'lock'])
def test_task_that_is_held_or_locked_stands_still_and_then_goes_on_where_it_was(way):
    asked, other = Asked(moving(), guarded=False, locked=way == 'lock'), moving()
    other.start(POSE, np.zeros((2, 3)))
    begin, here = 0, POSE
    if way == 'hold':
        begin, here = 500, Pose(np.array([0.1, 0.2, 0.3]), np.eye(3))
        for k in range(begin):
            asked.ask(k * H)
        asked.stay(here)
        asked.task.hold(True)
    for k in range(begin, begin + 300):
        out = asked.ask(k * H)
        np.testing.assert_array_equal(out.pose.position_world, here.position_world)
        assert not any(part.any() for part in (
            out.twist, out.acceleration, out.active, out.alpha_des))
    asked.task.hold(False)
    if way == 'lock':  # only a hold is released
        np.testing.assert_array_equal(
            asked.ask(300 * H).pose.position_world, POSE.position_world)
        asked.task.lock(False)
    np.testing.assert_allclose(
        asked.ask(800 * H).pose.position_world,
        other.task((800 - 300) * H).pose_des.position_world, atol=1e-12)
