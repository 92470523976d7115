"""Paths over a real graph: followed, held and resumed, ended, left by a client that is gone."""

import signal

from multicontact_control.client import CommandRefusedError, MultiContactClient
from multicontact_control.control.trajectory_checks import TimedPoses
from multicontact_control.errors import MessageError
from multicontact_control.nodes import messages, topics
import numpy as np
from numpy.testing import assert_allclose
import pytest
from ros_graph import end_of, obedient_graph, PATIENCE, start_command, wait_for

pytestmark = pytest.mark.ros


@pytest.fixture(scope='module')
def domain_id(tmp_path_factory):
    """Return the domain of a graph in lockstep that obeys commands."""
    with obedient_graph(tmp_path_factory.mktemp('graph')) as number:
        yield number


@pytest.fixture(scope='module')
def arm(domain_id):
    with MultiContactClient('arm', domain_id=domain_id, timeout=PATIENCE) as client:
        yield client


def line(state, *way, duration=1.0, count=5):
    """Return points on a straight line from where the arm should be [m]."""
    shares = np.linspace(0.0, 1.0, count)[:, np.newaxis]
    return TimedPoses(
        duration * shares[:, 0],
        state.position_desired + shares * np.array(way),
        np.tile(state.quaternion_desired, (count, 1)),
    )


def send(arm, points):
    """Command a path and return what the controller says of it."""
    message = messages.trajectory_message(points)
    return arm.command_until_answered(topics.TRAJECTORY_COMMAND, message)


def new_status(arm):
    """Return the newest status."""
    return wait_for(arm.status, 'a status')


def is_over(arm):
    arm.read()
    return new_status(arm).trajectory == ''


def test_controller_follows_a_path_and_tells_how_far_it_is(arm):
    start = arm.read()
    status = send(arm, line(start, 0.05, 0.0, 0.0))
    assert status.trajectory.startswith('moving 0.')
    assert status.remaining_time == pytest.approx(1.5, abs=0.2)
    wait_for(lambda: is_over(arm), 'the end of the path')
    assert_allclose(
        arm.read().position_world, start.position_desired + [0.05, 0, 0], atol=2e-3
    )
    send(arm, line(arm.read(), -0.05, 0.0, 0.0))
    wait_for(lambda: is_over(arm), 'the end of the path')


def test_path_is_held_and_resumed_also_by_another_client(arm, domain_id):
    start = arm.read()
    with MultiContactClient('arm', domain_id=domain_id, timeout=PATIENCE) as other:
        send(other, line(start, 0.0, -0.04, 0.0, duration=6.0))
        arm.hold()
    wait_for(lambda: new_status(arm).trajectory.startswith('held'), 'the hold')
    share = arm.last_status.trajectory_share
    arm.read()
    assert new_status(arm).trajectory_share == share
    arm.hold(False)
    wait_for(lambda: is_over(arm), 'the end of the path')
    goal = start.position_desired + [0.0, -0.04, 0.0]
    assert_allclose(arm.read().position_world, goal, atol=2e-3)
    send(arm, line(arm.read(), 0.0, 0.04, 0.0))
    wait_for(lambda: is_over(arm), 'the end of the path')


def test_empty_path_ends_the_one_that_is_followed(arm):
    start = arm.read()
    send(arm, line(start, 0.05, 0.0, 0.0, duration=5.0))
    none = TimedPoses(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))
    send(arm, none)
    wait_for(lambda: is_over(arm), 'the end of the path')
    way = arm.read().position_desired - start.position_desired
    assert np.linalg.norm(way) < 0.05


def test_path_that_is_too_fast_is_slowed_down_and_says_so(arm):
    status = send(arm, line(arm.read(), 0.0, 0.0, 0.0, duration=1.0))
    assert status.left_out == ''
    wait_for(lambda: is_over(arm), 'the end of the path')
    status = send(arm, line(arm.read(), 0.0, 0.0, 0.05, duration=0.05))
    assert 'slowed down' in status.left_out
    wait_for(lambda: is_over(arm), 'the end of the path')


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (
            {'times': np.array([0.0, 2.0, 1.0, 3.0, 4.0])},
            'point 2: time: expected more',
        ),
        ({'positions_world': np.full((5, 3), 9.0)}, 'point 0: position x: expected'),
        (
            {'times': np.array([0.0, 1.0, 2.0, 3.0, 3.0])},
            'point 4: time: expected more',
        ),
    ],
)
def test_refused_path_names_the_point_and_moves_nothing(arm, change, message):
    start = arm.read()
    with pytest.raises(CommandRefusedError, match=f'motion/trajectory: {message}'):
        send(arm, line(start, 0.05, 0.0, 0.0)._replace(**change))
    assert_allclose(arm.read().position_desired, start.position_desired, atol=1e-6)


def corners(arm, size):
    """Return a square of positions that begins and ends where the tool should be [m]."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, -1, 0], [0, -1, 0], [0, 0, 0]])
    return arm.read().position_desired + size * square


def test_client_follows_positions_and_shows_the_progress(arm):
    positions = corners(arm, 0.02)
    shares = []
    arm.follow(
        positions,
        speed=0.05,
        on_progress=lambda status: shares.append(status.trajectory_share),
    )
    assert shares == sorted(shares)
    assert len(shares) > 2
    assert shares[-1] == 1.0
    assert_allclose(arm.read().position_world, positions[-1], atol=2e-3)


def test_client_follows_positions_at_times_and_orientations(arm):
    positions = corners(arm, 0.02)
    quaternions = np.tile(arm.read().quaternion_desired, (5, 1))
    start = arm.read().time
    arm.follow(positions, times=[0.0, 1.0, 2.0, 3.0, 4.0], quaternions_xyzw=quaternions)
    assert arm.read().time - start >= 4.5


@pytest.mark.parametrize(
    ('given', 'message'),
    [
        ({'positions_world': [0.0, 0.5, 0.5]}, 'positions_world: expected shape'),
        ({'positions_world': [[0.0, 0.5, 0.5]], 'speed': 0.0}, 'speed: expected above'),
        (
            {'positions_world': [[0.0, 0.5, 0.5]], 'times': [0.0, 1.0]},
            'times: expected',
        ),
        (
            {'positions_world': [[0.0, 0.5, 0.5]], 'quaternions_xyzw': [0, 0, 0, 1]},
            'quaternions_xyzw: expected shape',
        ),
        ({'positions_world': [[0.0, np.nan, 0.5]]}, 'point 0: translation: expected'),
    ],
)
def test_client_names_what_is_no_path(arm, given, message):
    with pytest.raises(MessageError, match=message):
        arm.follow(**given)


def test_client_waits_for_a_path_that_another_has_begun(arm, domain_id):
    start = arm.read()
    with MultiContactClient('arm', domain_id=domain_id, timeout=PATIENCE) as other:
        send(other, line(start, 0.03, 0.0, 0.0))
    arm.await_path()
    goal = start.position_desired + [0.03, 0.0, 0.0]
    assert_allclose(arm.read().position_world, goal, atol=2e-3)
    arm.move(start.position_desired, 1.0)


FLAT = 'u, v\n0, 0\n0.02, 0\n0.02, -0.02\n0, -0.02\n0, 0\n'


def test_command_presses_and_follows_a_file_is_held_by_a_signal_and_resumes(
    arm, domain_id, tmp_path
):
    path = tmp_path / 'path.csv'
    path.write_text(FLAT)
    options = ('--namespace', 'arm', '--domain-id', str(domain_id))
    start = arm.read()
    first = start_command(
        'follow', str(path), '--force', 'table=10', '--speed', '0.01', *options
    )
    wait_for(lambda: new_status(arm).trajectory.startswith('moving'), 'the path')
    first.send_signal(signal.SIGINT)
    text, _ = end_of(first)
    assert first.returncode == 130
    assert 'held: multicontact follow --resume' in text
    arm.read()
    assert new_status(arm).held
    text, _ = end_of(start_command('follow', '--resume', *options))
    assert text.split()[-1] == 'done'
    assert arm.read().forces_desired['table'] == 10.0
    assert abs(arm.read().position_world[0] - start.position_world[0]) < 2e-3
    text, _ = end_of(start_command('follow', '--end', *options))
    assert text.strip() == 'ended'
    arm.set_forces({'table': 0.0})


def test_path_goes_on_when_its_client_is_killed(arm, domain_id, tmp_path):
    path = tmp_path / 'path.csv'
    start = arm.read().position_desired
    rows = [f'{start[0] + x:.6f}, {start[1]:.6f}, {start[2]:.6f}' for x in (0.0, 0.03)]
    path.write_text('\n'.join(['x, y, z', *rows]))
    options = ('--speed', '0.01', '--namespace', 'arm', '--domain-id', str(domain_id))
    client = start_command('follow', str(path), *options)
    wait_for(lambda: new_status(arm).trajectory.startswith('moving'), 'the path')
    client.kill()
    end_of(client)
    arm.await_path()
    goal = start + [0.03, 0.0, 0.0]
    assert_allclose(arm.read().position_world, goal, atol=2e-3)
    arm.move(start, 1.0)


@pytest.mark.parametrize(
    ('text', 'options', 'message'),
    [
        (FLAT, ('--force', 'table'), "--force: expected CONTACT=NEWTONS, got 'table'"),
        ('u, v\n', (), 'expected at least one point, got none'),
        ('u, v, force\n0, 0, 3\n', (), 'point 0: expected no force'),
        ('a, b\n0, 0\n', (), 'expected columns x, y, z or u, v'),
        (FLAT, ('--resume',), 'PATH: expected a file, or --resume, or --end'),
    ],
)
def test_command_refuses_in_one_line_what_is_no_path(tmp_path, text, options, message):
    path = tmp_path / 'path.csv'
    path.write_text(text)
    command = start_command('follow', str(path), *options)
    _, error = end_of(command)
    assert command.returncode == 2
    assert message in error
    assert len(error.strip().splitlines()) == 1
