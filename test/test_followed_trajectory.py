"""A trajectory that the control loop follows: its points, and what interrupts and ends it."""

from multicontact_control.control.tasks import MotionReading
from multicontact_control.control.trajectory_checks import TimedPoses
from multicontact_control.errors import CommandError
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
from numpy.testing import assert_allclose
import pytest

FORCE = 10.0  # N
LARGEST_ERROR = 0.002  # m
GIVEN = {'plant': 'rigid'}
NO_POINTS = TimedPoses(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))


class Follower:
    """A closed loop that obeys commands, with what it did at every tick."""

    def __init__(self, force=0.0):
        self.loop = ClosedLoop(resolve('circle', **GIVEN), commanded=True)
        self.control = self.loop.control
        self.names = self.loop.setup.controller.contact_names
        self.positions = []
        self.wanted = []
        self.progress = []
        self.run(0.1)
        if force:
            self.control.set_forces({'table': force})
            self.run(3.0)
            assert self.control.status.contact_states == ('holding',)
        self.start = self.control.output.pose_des

    def run(self, seconds):
        for _ in range(round(seconds * 500)):
            self.loop.advance()
            output = self.control.output
            self.positions.append(output.pose.position_world.copy())
            self.wanted.append(output.pose_des.position_world.copy())
            self.progress.append(self.control.progress)

    def points(self, *offsets, speed=0.1, last=None):
        """Return points at offsets from the start [m], and their twists at rest if wanted."""
        offsets = np.array(offsets, dtype=float).reshape(-1, 3)
        ways = np.linalg.norm(np.diff(offsets, axis=0), axis=1)
        times = np.concatenate([[0.0], np.cumsum(ways / speed)])
        quaternions = np.tile(self.start.quaternion_xyzw, (len(offsets), 1))
        return TimedPoses(times, self.start.position_world + offsets, quaternions)

    @property
    def offset(self):
        return self.positions[-1] - self.start.position_world


SQUARE = [(0, 0, 0), (0.05, 0, 0), (0.05, 0.05, 0), (0, 0.05, 0), (0, 0, 0)]
LINE = [(0, 0, 0), (0.1, 0, 0), (0.2, 0, 0)]


@pytest.mark.parametrize('force', [0.0, FORCE])
def test_passes_every_point_and_ends_at_rest(force):
    arm = Follower(force)
    points = arm.points(*SQUARE)
    first = len(arm.positions)
    arm.control.set_trajectory(points)
    arm.run(4.0)
    path = np.array(arm.positions[first:])
    for corner in points.positions_world:
        distances = np.linalg.norm((path - corner)[:, :2], axis=1)
        assert distances.min() < LARGEST_ERROR
    assert arm.control.progress is None
    assert arm.control.status.reaction == 'none'
    twist = np.array(arm.wanted[-1]) - np.array(arm.wanted[-2])
    assert np.linalg.norm(twist[:2]) < 1e-6
    assert_allclose(arm.offset[:2], 0.0, atol=LARGEST_ERROR)
    if force:
        assert abs(arm.control.output.contacts['alpha_meas'][0] - FORCE) < 1.0


def test_tells_how_far_it_is():
    arm = Follower()
    arm.control.set_trajectory(arm.points(*LINE))
    arm.run(1.0)
    progress = arm.progress[-1]
    assert progress.share == pytest.approx(1.0 / 2.5, abs=0.01)
    assert progress.remaining == pytest.approx(1.5, abs=0.01)
    assert not progress.waits


def test_a_hold_pauses_it_and_a_release_resumes_it_where_it_was():
    arm = Follower(FORCE)
    arm.control.set_trajectory(arm.points(*LINE))
    arm.run(1.0)
    arm.control.hold(True)
    arm.run(0.5)
    held_at = arm.offset
    share = arm.control.progress.share
    arm.run(0.5)
    assert np.linalg.norm(arm.offset - held_at) < 0.005
    assert arm.control.progress.share == share
    with pytest.raises(CommandError, match='held'):
        arm.control.set_trajectory(arm.points(*LINE))
    arm.control.hold(False)
    arm.run(3.0)
    assert arm.control.progress is None
    assert_allclose(arm.offset[:2], [0.2, 0.0], atol=LARGEST_ERROR)
    steps = np.diff(np.array(arm.wanted), axis=0)[:, :2]
    assert np.linalg.norm(steps, axis=1).max() < 1.3 * 0.1 / 500.0


def test_none_ends_it_with_a_stop_and_also_while_it_is_held():
    for held in (False, True):
        arm = Follower()
        arm.control.set_trajectory(arm.points(*LINE))
        arm.run(1.0)
        if held:
            arm.control.hold(True)
            arm.run(0.1)
        before = arm.offset
        arm.control.set_trajectory(NO_POINTS)
        if held:
            arm.control.hold(False)
        arm.run(1.0)
        assert arm.control.progress is None
        assert 0.0 < np.linalg.norm(arm.offset - before) < 0.015


def test_a_new_one_takes_its_place_without_a_jump():
    arm = Follower()
    arm.control.set_trajectory(arm.points(*LINE))
    arm.run(1.0)
    arm.control.set_trajectory(arm.points((0.0, 0.05, 0.0)))
    arm.run(3.0)
    assert arm.control.progress is None
    assert_allclose(arm.offset, [0.0, 0.05, 0.0], atol=LARGEST_ERROR)
    velocity = np.diff(np.array(arm.wanted), axis=0) * 500.0
    acceleration = np.diff(velocity, axis=0) * 500.0
    assert np.linalg.norm(acceleration, axis=1).max() < 5.0


def test_a_refused_one_leaves_the_present_one_alone():
    arm = Follower(FORCE)
    arm.control.set_trajectory(arm.points(*LINE))
    arm.run(0.5)
    sudden = arm.points(*LINE)._replace(times=np.array([0.0, 1e-9, 5.0]))
    for points, message in (
        (
            arm.points((0, 0, 0), (0.0, 0.0, -0.1)),
            'point 1: .* of table.* through them',
        ),
        (arm.points((0, 0, 0), (9.0, 0.0, 0.0)), 'point 1: position x: expected'),
        (sudden, 'point 1: time: expected at least'),
    ):
        with pytest.raises(CommandError, match=message):
            arm.control.set_trajectory(points)
    arm.run(3.0)
    assert_allclose(arm.offset[:2], [0.2, 0.0], atol=LARGEST_ERROR)


def test_waits_for_a_contact_that_is_lost_and_goes_on_with_it():
    arm = Follower(FORCE)
    arm.control.set_trajectory(arm.points(*LINE, speed=0.05))
    arm.run(1.0)
    arm.loop.plant.contacts.shift_surface(0, 0.004)
    arm.run(0.3)
    waiting = [progress.waits for progress in arm.progress[-100:]]
    assert any(waiting)
    arm.run(6.0)
    assert arm.control.progress is None
    assert arm.control.status.contact_states == ('holding',)
    assert_allclose(arm.offset[:2], [0.2, 0.0], atol=LARGEST_ERROR)


def test_stands_still_while_a_reaction_takes_the_place_of_control():
    arm = Follower()
    arm.control.set_trajectory(arm.points(*LINE))
    arm.run(1.0)
    for _ in range(50):  # no wrench: the arm is held
        arm.loop.answer(lambda inputs: inputs._replace(wrench=None))
        arm.loop.act()
    assert arm.control.status.reaction == 'hold'
    share = arm.control.progress.share
    arm.run(0.2)
    assert arm.control.progress.share == pytest.approx(share, abs=0.02)
    arm.run(4.0)
    assert arm.control.status.reaction == 'none'
    assert arm.control.progress is None
    assert_allclose(arm.offset, [0.2, 0.0, 0.0], atol=LARGEST_ERROR)


def test_a_new_one_takes_the_place_of_one_that_waits():
    arm = Follower(FORCE)
    arm.control.set_trajectory(arm.points(*LINE))
    arm.run(1.0)
    arm.control.hold(True)
    arm.run(0.3)
    arm.control.hold(False)
    arm.run(0.02)
    assert arm.progress[-1].waits
    arm.control.set_trajectory(arm.points((0.0, 0.0, 0.0)))
    arm.run(3.0)
    assert arm.control.progress is None
    assert_allclose(arm.offset[:2], 0.0, atol=LARGEST_ERROR)


def test_a_set_point_takes_its_place():
    arm = Follower()
    arm.control.set_trajectory(arm.points(*LINE))
    arm.run(0.5)
    request = arm.control.request_trajectory(arm.points(*LINE))
    trajectory = request.plan()
    output = arm.control.output
    pose = output.pose_des
    motion = MotionReading(
        pose.position_world, pose.quaternion_xyzw, np.zeros(6), np.zeros(6)
    )
    arm.control.set_motion(motion)
    assert arm.control.progress is None
    with pytest.raises(CommandError, match='another motion was commanded'):
        arm.control.follow(request, trajectory)
