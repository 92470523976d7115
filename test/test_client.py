"""The Python client against the real graph."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
import time

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped
from multicontact_control.client import (
    CommandRefusedError,
    MultiContactClient,
    NotReachedError,
)
from multicontact_control.errors import MessageError, MulticontactError, RunError
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph import (
    create_publisher,
    ignore_message,
    take_message,
)
from multicontact_control.nodes.link import ServiceClientNode
from multicontact_control.nodes.messages import ACCEPTED, ControllerStatus
import numpy as np
from numpy.testing import assert_allclose
import pytest
from ros_graph import obedient_graph, PATIENCE, wait_for

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


def test_first_command_is_sent_again_to_a_recorder_that_is_connected_after_it(
    domain_id,
):
    topic = topics.FORCE_COMMAND
    command = messages.joint_state_message(0, ['table'], effort=[10.0])
    with (
        ServiceClientNode('controller_node', domain_id, 'small') as controller,
        MultiContactClient('small', domain_id=domain_id, timeout=PATIENCE) as client,
        ThreadPoolExecutor(1) as pool,
    ):
        subscribe = partial(
            controller.node.create_subscription,
            topic.message,
            topic.name,
            ignore_message,
            topic.profile,
        )
        status = create_publisher(controller.node, topics.STATUS)
        heard = subscribe()
        sending = pool.submit(client.command_until_answered, topic, command)
        first, _ = wait_for(lambda: take_message(heard), 'the command')
        recorder = subscribe()
        accepted = ControllerStatus(  # the controller knows of 2 readers
            ACCEPTED,
            first.header.frame_id,
            'ok',
            'active',
            'none',
            '',
            '',
            False,
            0,
            2,
            '',
            {},
        )
        message = accepted.to_message('status', DiagnosticStatus.OK)
        wait_for(lambda: status.publish(message) or sending.done(), 'the client')
        assert wait_for(lambda: take_message(recorder), 'the record')[
            0
        ].effort.tolist() == [10.0]


def reached(arm, **forces):
    """Return the state once what is commanded is reached, with these forces if there are any."""
    if forces:
        arm.set_forces(forces)
    return arm.wait_until_reached(force_tolerance=0.5, timeout=PATIENCE)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({}, 'table is off by'),
        ({'contacts': 'table free, board holding'}, 'table is free'),
        ({'reaction': 'hold', 'text': 'hold: wrench_stale'}, 'hold: wrench_stale'),
    ],
)
def test_forces_that_are_not_held_are_not_reached(arm, monkeypatch, changes, message):
    reached(arm, table=8.0, board=4.0)
    monkeypatch.setattr(arm, 'status', lambda: replace(arm.last_status, **changes))
    with pytest.raises(NotReachedError, match=message):
        arm.wait_until_reached(10.0 if changes else 0.0, timeout=0.5)


def test_client_presses_moves_and_keeps_pressing(arm, monkeypatch):
    reached(arm, table=5.0, board=4.0)
    state = reached(arm, table=10.0)
    assert state.forces_desired == {'table': 10.0, 'board': 4.0}
    R = wait_for(
        lambda: arm.read().noise_variance, 'the estimator, which may be found later'
    )
    assert set(R) == {'table', 'board'}
    goal = state.position_desired + [0.03, 0.0, 0.0]
    read, way = arm.read, []

    def late():
        time.sleep(0.5 * (len(way) == 20))  # a program that is busy for a while
        way.append(read())
        return way[-1]

    monkeypatch.setattr(arm, 'read', late)
    arm.move(goal, duration=1.0)
    seen = np.array([(state.time, state.position_desired[0]) for state in way])
    times, places = seen[np.diff(seen[:, 0], prepend=-1.0) > 0.0].T
    assert np.abs(np.diff(places) / np.diff(times)).max() < 1.01 * 15.0 / 8.0 * 0.03
    monkeypatch.undo()
    after = reached(arm)
    assert_allclose(after.position_desired, goal, atol=1e-12)
    assert abs(after.position_world[0] - goal[0]) < 0.003


def test_held_arm_refuses_forces_and_motions_until_it_is_released(arm):
    reached(arm, table=8.0, board=4.0)
    before = arm.read()
    arm.hold()
    with pytest.raises(
        CommandRefusedError, match='contact_forces/command: ~/hold: the arm'
    ):
        arm.set_forces({'table': 12.0})
    with pytest.raises(CommandRefusedError, match='motion/trajectory: ~/hold: the arm'):
        arm.move(before.position_desired + [0.02, 0.0, 0.0], duration=0.2)
    assert arm.status().held and arm.status().refused >= 2
    held = arm.read()
    assert held.forces_desired == {'table': 8.0, 'board': 4.0}
    assert_allclose(held.position_desired, before.position_world, atol=0.002)
    arm.hold(False)
    assert reached(arm, table=12.0).forces_desired == {'table': 12.0, 'board': 4.0}
    with pytest.raises(RunError, match='tare refused: contacts: let go'):
        arm.tare()


def test_refused_forces_and_motions_change_no_target(arm):
    arm.set_forces({'table': 8.0, 'board': 4.0})
    for forces, centres, words in (
        ({'tabel': 5.0, 'board': 6.0}, {}, 'name: expected distinct names among'),
        (
            {'board': 99.0, 'table': 5.0},
            {},
            'force on board: expected 0 or 3 to 30 N, got',
        ),
        ({}, {'table': 0.01}, 'table'),
    ):
        with pytest.raises(CommandRefusedError, match=words):
            arm.set_forces(forces, centres)
    assert reached(arm).forces_desired == {'table': 8.0, 'board': 4.0}
    assert arm.status().forces == {'table': 8.0, 'board': 4.0}
    for duration in (0.0, float('nan')):
        with pytest.raises(MessageError, match='duration: expected above 0 s, got'):
            arm.move([0.0, 0.5, 0.5], duration)
    start = arm.read()
    with pytest.raises(
        CommandRefusedError, match='motion/trajectory: position x: expected -0.6 to'
    ):
        arm.move(start.position_desired + [2.0, 0.0, 0.0], duration=0.3)
    assert abs(arm.read().position_desired[0] - start.position_desired[0]) < 1e-4


@pytest.mark.parametrize(
    ('way', 'duration', 'shortest'),
    [
        ([0.1, 0.0, 0.0], 0.01, 0.375),
        ([0.1, 0.0, 0.0], 0.37, 0.375),
        ([0.01, 0.0, 0.0], 0.1, 0.107),
    ],
)  # by the speed, and by the acceleration
def test_move_that_the_limits_do_not_allow_is_refused_with_the_shortest_duration(
    arm, way, duration, shortest
):
    start = arm.read()
    with pytest.raises(
        CommandRefusedError,
        match=(
            f'motion/trajectory: duration: expected at least {shortest:g} s for .*'
            f'got {duration:g} s'
        ),
    ):
        arm.move(start.position_desired + way, duration)
    assert np.abs(arm.read().position_desired - start.position_desired).max() < 1e-4


def test_move_along_a_held_normal_is_refused_and_moves_nothing(arm):
    reached(arm, table=8.0, board=4.0)
    start = arm.read()
    with pytest.raises(
        CommandRefusedError,
        match=(
            'motion/trajectory: goal: expected at most 0.005 m .* where contacts place the tool, '
            'got 0.05 m .* let go of table, board first'
        ),
    ):
        arm.move(start.position_desired + [0.01, 0.0, 0.05], 1.0)
    assert np.abs(arm.read().position_desired - start.position_desired)[0] < 1e-4


def test_motion_along_a_held_normal_is_accepted_with_what_is_left_out(arm):
    reached(arm, table=8.0, board=4.0)
    start = arm.read()
    point = messages.motion_message(
        start.position_desired + [0.0, 0.0, 0.05],
        start.quaternion_desired,
        np.zeros(6),
        np.zeros(6),
    )
    status = arm.command_until_answered(topics.MOTION_COMMAND, point)
    assert set(status.placing) == {'table', 'board'}
    assert (
        '50 mm and 0 rad of the way are not obeyed: there table, board'
        in status.left_out
    )
    assert status.left_out in status.text
    along = messages.motion_message(
        start.position_desired, start.quaternion_desired, np.zeros(6), np.zeros(6)
    )
    assert arm.command_until_answered(topics.MOTION_COMMAND, along).left_out == ''


def test_move_in_a_reaction_that_waits_for_an_operator_raises_place_and_cause(
    arm, monkeypatch
):
    reached(arm, table=8.0, board=4.0)
    start = arm.read()
    command = arm.command_until_answered

    def latched(*given):
        return replace(
            command(*given),
            reaction='hold',
            causes='latched',
            text='hold instead of control: latched',
        )

    monkeypatch.setattr(arm, 'command_until_answered', latched)
    with pytest.raises(
        NotReachedError,
        match=(
            r'motion/trajectory: ended at \[.*\] m, 20 mm from the goal: hold instead of control: '
            'latched'
        ),
    ):
        arm.move(start.position_desired + [0.02, 0.0, 0.0], 0.5)


def test_move_returns_only_within_its_tolerance(arm):
    reached(arm, table=8.0, board=4.0)
    start = arm.read()
    goal = start.position_desired + [0.02, 0.0, 0.0]
    arm.move(goal, 0.5)
    assert abs(arm.read().position_world[0] - goal[0]) <= 0.005
    arm.set_forces({'table': 0.0, 'board': 0.0})
    wait_for(lambda: not arm.status().placing, 'both contacts to be let go')
    with pytest.raises(NotReachedError, match='mm from the goal: ok'):
        arm.move(arm.read().position_desired, 0.5, position_tolerance=1e-18)


@pytest.mark.parametrize(
    ('call', 'words'),
    [
        (lambda arm: arm.set_forces(None), 'forces: expected numbers by name'),
        (lambda arm: arm.set_forces([10.0, 5.0]), 'forces: expected numbers by name'),
        (
            lambda arm: arm.set_forces({'table': np.array([10.0])}),
            r"forces\['table'\]: expected one",
        ),
        (
            lambda arm: arm.set_forces({'table': '10'}),
            r"forces\['table'\]: expected one finite",
        ),
        (
            lambda arm: arm.set_forces({1: 10.0}),
            'forces: expected names that are text, got 1',
        ),
        (lambda arm: arm.set_forces({}, [0.1]), 'centres: expected numbers by name'),
        (
            lambda arm: arm.move([0.0, 0.5, 0.5], '1'),
            "duration: expected above 0 s, got '1'",
        ),
        (
            lambda arm: arm.move(np.zeros((3, 1)), 1.0),
            r'position_world: expected 3 values in one row, got an array of shape \(3, 1\)',
        ),
        (
            lambda arm: arm.move(['a', 'b', 'c'], 1.0),
            'position_world: expected 3 values that are',
        ),
        (
            lambda arm: arm.move([[0.0], 0.5, 0.5], 1.0),
            'position_world: expected 3 values in one',
        ),
        (
            lambda arm: arm.move([0.0, 0.5, 0.5], 1.0, quaternion_xyzw=[0, 0, 0, 0]),
            'quaternion_xyzw: expected a quaternion of a length above 0',
        ),
        (
            lambda arm: arm.move([0.0, 0.5, 0.5], 1.0, position_tolerance=None),
            'position_tolerance: expected above 0 m, got None',
        ),
        (
            lambda arm: arm.wait_until_reached('0.5'),
            'force_tolerance: expected one finite number',
        ),
        (
            lambda arm: arm.wait_until_reached(-1.0),
            'force_tolerance: expected at least 0 N, got -1 N',
        ),
        (
            lambda arm: arm.wait_until_reached(timeout=-1.0),
            'timeout: expected at least 0 s, got -1 s',
        ),
        (
            lambda arm: arm.set_parameters(
                'controller_node', {'tool.mass': 1.0, 'nosuch': 1}
            ),
            "controller_node: expected parameters that it has, got 'nosuch'$",
        ),
        (
            lambda arm: arm.get_parameters('controller_node', 'tool.mass', 'nosuch'),
            "controller_node: expected parameters that it has, got 'nosuch'$",
        ),
        (lambda arm: arm.hold('yes'), "on: expected true or false, got 'yes'"),
        (
            lambda arm: arm.set_parameters('controller_node', {'tool.mass': object()}),
            'tool.mass: expected a number, a text',
        ),
        (
            lambda arm: MultiContactClient(domain_id=999),
            'domain_id: expected a whole number from 0',
        ),
        (
            lambda arm: MultiContactClient(domain_id='5a'),
            'domain_id: expected a whole number from 0',
        ),
        (
            lambda arm: MultiContactClient('no name', domain_id=5),
            'namespace: expected names of',
        ),
        (
            lambda arm: MultiContactClient(timeout='long'),
            "timeout: expected above 0 s, got 'long'",
        ),
    ],
)
def test_client_names_what_is_wrong_with_what_it_is_given(arm, call, words):
    with pytest.raises(MulticontactError, match=words):
        call(arm)


def test_closed_client_says_so_whatever_it_is_asked(domain_id):
    with MultiContactClient('arm', domain_id=domain_id, timeout=PATIENCE) as client:
        client.read()
    client.close()  # once more makes no difference
    for call in (
        client.read,
        client.status,
        client.activate,
        client.deactivate,
        client.hold,
        client.tare,
        client.retry,
        client.wait_until_reached,
        lambda: client.set_forces({'table': 5.0}),
        lambda: client.move([0.0, 0.5, 0.5], 1.0),
    ):
        with pytest.raises(
            RunError, match='expected an open connection, got one that is closed'
        ):
            call()


def test_push_that_no_person_can_give_is_refused_and_moves_nothing(arm, domain_id):
    before = arm.read()
    with ServiceClientNode('pusher', domain_id, 'arm') as pusher:
        heard = pusher.node.create_subscription(
            topics.DIAGNOSTICS.message,
            topics.DIAGNOSTICS.name,
            ignore_message,
            topics.DIAGNOSTICS.profile,
        )
        push = create_publisher(pusher.node, topics.PUSH)
        message = Vector3Stamped()
        message.vector.z = 1e6

        def refusal():
            push.publish(message)
            taken = take_message(heard)
            return taken and [
                value.key
                for part in taken[0].status
                for value in part.values
                if 'sim_node/push: vector' in value.key
            ]

        assert 'expected at most 150 N' in wait_for(refusal, 'the refusal')[0]
    assert np.linalg.norm(arm.read().position_world - before.position_world) < 0.002


def test_each_of_two_clients_learns_what_becomes_of_its_own_commands(arm, domain_id):
    arm.set_forces({'table': 8.0, 'board': 4.0})

    def press():
        for force in range(1, 21):
            arm.set_forces({'table': 8.0 + 0.1 * force})

    with (
        MultiContactClient('arm', domain_id=domain_id, timeout=PATIENCE) as other,
        ThreadPoolExecutor(1) as pool,
    ):
        pressing = pool.submit(press)
        for force in range(41, 61):
            with pytest.raises(CommandRefusedError, match=f'board: .* got {force} N'):
                other.set_forces({'board': float(force)})
        pressing.result()
    assert reached(arm).forces_desired == {'table': 10.0, 'board': 4.0}


def test_clients_made_in_threads_at_once_all_command_and_read(arm, domain_id):
    reached(arm, table=8.0, board=4.0)

    def press(number):
        with MultiContactClient('arm', domain_id=domain_id, timeout=PATIENCE) as client:
            for force in (5.0, 5.25, 5.5):
                client.set_forces({'table': force + number})
            return client.read().time, client.status().forces['table']

    with ThreadPoolExecutor(3) as pool:
        answers = [*pool.map(press, range(3))]
    assert all(time > 0.0 and 5.0 <= force < 8.0 for time, force in answers)
    last = arm.status().forces['table']
    assert last in (5.5, 6.5, 7.5)  # each has sent all of its own, and nothing is lost
    assert reached(arm).forces_desired == {'table': last, 'board': 4.0}


def test_client_deactivates_and_activates_a_real_controller(arm, domain_id):
    reached(arm, table=5.0, board=5.0)
    with (
        ServiceClientNode('driver', domain_id, 'arm') as driver,
        MultiContactClient('arm', domain_id=domain_id, timeout=1.0) as impatient,
    ):
        for _ in range(2):  # once more makes no difference
            arm.deactivate()
            assert driver.get_state('controller_node') == 'inactive'
        for call in (impatient.read, lambda: impatient.set_forces({'table': 5.0})):
            with pytest.raises(RunError, match='is the controller active'):
                call()
        with pytest.raises(RunError, match='hold refused: controller: it is inactive'):
            arm.hold()
        for _ in range(2):
            arm.activate()
            assert driver.get_state('controller_node') == 'active'
        # What was commanded before is forgotten, by both.
        assert arm.read().forces_desired == {'table': 0.0, 'board': 0.0}
        assert reached(arm, table=6.0).forces_desired == {'table': 6.0, 'board': 0.0}


def test_missing_controller_is_named(domain_id):
    with MultiContactClient('missing', domain_id=domain_id, timeout=0.2) as client:
        for call in (client.read, lambda: client.set_forces({'table': 1.0})):
            with pytest.raises(
                RunError, match='expected a message within 0.2 s in ROS domain'
            ):
                call()
        with pytest.raises(
            RunError, match='/missing/controller_node/tare: expected this service'
        ):
            client.tare()
