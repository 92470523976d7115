"""Motions that lead to joint stops and out of reach: forces stay, and the arm comes back."""

from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from multicontact_control.algebra import quintic_blend
from multicontact_control.control.tasks import MotionReading
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest
from robots import needs_mujoco, ROBOTS
from scipy.spatial.transform import Rotation
from sim_bridge.new_robot import new_robot
from sim_bridge.posture import find_posture_at, frame_pose, joint_limits
from sim_bridge.robots import find_robot

URDF = Path(__file__).parents[1] / 'data' / 'six_joints.urdf'
FORCE = 10.0  # N
REST = 1.0  # s at the far end, and after the way back


class Course(NamedTuple):
    """A motion out and back along a direction: a line [m], or a turn about it [rad]."""

    direction: tuple[float, float, float]
    distance: float
    speed: float  # largest [m/s, rad/s]
    turns: bool = False

    @property
    def duration(self):
        return 1.875 * self.distance / self.speed  # of the quintic_blend, one way

    def at(self, time, start):
        """Return the motion command at a time [s] after a start pose."""
        out = np.array(quintic_blend(time, self.duration))
        back = np.array(quintic_blend(time - self.duration - REST, self.duration))
        way, rate, change = self.distance * (out - back)
        direction = np.array(self.direction)
        position = start.position_world
        rotation = Rotation.from_matrix(start.rotation_world)
        twist = np.zeros(6)
        acceleration = np.zeros(6)
        if self.turns:
            rotation = Rotation.from_rotvec(way * direction) * rotation
            twist[3:] = rate * direction
            acceleration[3:] = change * direction
        else:
            position = position + way * direction
            twist[:3] = rate * direction
            acceleration[:3] = change * direction
        return MotionReading(position, rotation.as_quat(), twist, acceleration)


class Seen(NamedTuple):
    """What was seen along a course, a row for each tick."""

    q: np.ndarray
    qd: np.ndarray
    force: np.ndarray  # true, on the table [N]
    position: np.ndarray  # of the operational point [m]
    limits: set
    reactions: set


def follow(course, *, pressing, stops=None, **chosen):
    """Follow a course with one contact, or in the air; return the limits and what was seen."""
    names = {'contact_names': ['table']}
    limits = {'workspace_lower': [-9.0] * 3, 'workspace_upper': [9.0] * 3}
    if stops is not None:
        limits |= stops
    setup = resolve(
        'one_contact',
        controller={**names, 'limits': limits},
        noise_estimator=names,
        plant_overrides={
            **names,
            'surfaces': {'table': {'roughness_std': 0.0}},
            **chosen.pop('plant_overrides', {}),
        },
        **chosen,
    )
    loop = ClosedLoop(setup, commanded=True)
    period = setup.controller.period
    joints, speeds, forces, positions = [], [], [], []
    limited = set()
    reactions = set()
    with closing(loop):
        for _ in range(50):
            loop.advance()
        if pressing:
            loop.control.set_forces({'table': FORCE})
            for _ in range(1100):
                loop.advance()
        start = loop.control.output.pose_des
        for tick in range(round((2.0 * course.duration + 3.0 * REST) / period)):
            loop.control.set_motion(course.at(tick * period, start))
            loop.advance()
            joints.append(loop.plant.arm.q.copy())
            speeds.append(loop.plant.arm.qd.copy())
            forces.append(loop.sample.contact_force[0])
            positions.append(loop.control.output.pose.position_world)
            limited.update(loop.status.limits)
            reactions.add(loop.status.reaction)
    series = map(np.array, (joints, speeds, forces, positions))
    return setup.controller.limits, Seen(*series, limited, reactions)


def assert_safe(limits, seen, *, pressing):
    """No stop is passed, no joint too fast, the force stays, and the arm is back at the end."""
    beyond = np.maximum(limits.joint_lower - seen.q, seen.q - limits.joint_upper)
    assert beyond.max() < 0.01
    assert (np.abs(seen.qd) <= limits.joint_speed).all()
    assert seen.reactions == {'none'}
    if pressing:
        assert np.abs(seen.force - FORCE).max() < 3.0
    assert np.linalg.norm(seen.position[-1] - seen.position[0]) < 0.005


DIRECTIONS = [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)]


@pytest.mark.slow
@pytest.mark.parametrize('robot', ROBOTS)
@pytest.mark.parametrize('direction', [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0)])
def test_slide_out_of_reach_ends_and_comes_back_while_the_force_stays(robot, direction):
    limits, seen = follow(Course(direction, 0.6, 0.4), pressing=True, robot=robot)
    assert_safe(limits, seen, pressing=True)
    assert seen.limits & {'reach', 'joint'}
    assert 'reference' in seen.limits


@pytest.mark.slow
@pytest.mark.parametrize('robot', ROBOTS)
@pytest.mark.parametrize('joint', [0, -1])
@pytest.mark.parametrize('pressing', [True, False])
def test_joint_led_to_its_stop_holds_there_and_the_force_stays(robot, joint, pressing):
    """The stop is set 0.15 rad beyond home; a slide or a turn about the vertical leads there."""
    home = np.array(find_robot(robot).plant_values('')['home'])
    base = resolve('one_contact', robot=robot).controller.limits
    lower = np.array(base.joint_lower)
    upper = np.array(base.joint_upper)
    lower[joint] = home[joint] - 0.15
    upper[joint] = home[joint] + 0.15
    stops = {'joint_lower': lower.tolist(), 'joint_upper': upper.tolist()}
    sideways = (1.0, 0.0, 0.0)
    if robot == 'iiwa_sanding':  # which looks along x, the others along y
        sideways = (0.0, -1.0, 0.0)
    if joint == 0:
        course = Course(sideways, 0.25, 0.1)
    else:
        course = Course((0.0, 0.0, 1.0), 0.6, 0.4, turns=True)
    limits, seen = follow(course, pressing=pressing, robot=robot, stops=stops)
    assert_safe(limits, seen, pressing=pressing)
    if len(home) == 6:  # with a seventh joint the others go around it
        assert 'joint' in seen.limits


@pytest.fixture(scope='module')
def foreign(tmp_path_factory):
    """Return the file of a robot that `new-robot` writes for an arm of another make."""
    folder = tmp_path_factory.mktemp('foreign')
    new_robot(URDF, 'l6', 'l6', folder / 'arm.yaml', folder / 'controller.yaml')
    return str(folder / 'arm.yaml')


@needs_mujoco
@pytest.mark.slow
@pytest.mark.parametrize('direction', DIRECTIONS)
def test_foreign_arm_in_mujoco_ends_at_the_edge_of_its_reach(foreign, direction):
    limits, seen = follow(
        Course(direction, 0.5, 0.3),
        pressing=True,
        robot=foreign,
        plant_overrides={'engine': 'mujoco'},
    )
    assert_safe(limits, seen, pressing=True)


def test_box_of_a_new_robot_is_reached_everywhere(foreign):
    robot = find_robot(foreign)
    model = robot.arm.model()
    home = np.array(robot.file.home)
    lower = np.array(robot.file.workspace_lower)
    upper = np.array(robot.file.workspace_upper)
    pose = frame_pose(model, home)
    assert (lower < pose.translation).all()
    assert (pose.translation < upper).all()
    assert (upper - lower > 0.15).all()
    lowest, highest = joint_limits(model)
    for point in np.random.default_rng(1).uniform(lower, upper, (20, 3)):
        pose.translation = point
        q = find_posture_at(model, pose, home)
        assert q is not None
        assert (lowest <= q).all()
        assert (q <= highest).all()
