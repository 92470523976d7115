"""The Python client against the real graph, and against a stand-in for what a graph may lack."""

from __future__ import annotations

import itertools
import threading
import warnings

from lifecycle_msgs.srv import ChangeState, GetState
from multicontact_control.client import (
    CommandRefusedError,
    CommandRefusedWarning,
    MultiContactClient,
    STATE_TOPICS,
)
from multicontact_control.errors import RunError
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph_node import create_publisher, create_subscription, ignore
from multicontact_control.nodes.link import (
    ACTIVATE,
    CLEAN_UP,
    CONFIGURE,
    DEACTIVATE,
    GOALS,
    GuestNode,
    LifecycleDriver,
)
import numpy as np
import pytest
from rclpy.executors import SingleThreadedExecutor
from ros_graph import get_parameter, obedient_graph, own_domain, PATIENCE, wait_for
from std_srvs.srv import SetBool, Trigger

pytestmark = pytest.mark.ros


@pytest.fixture(scope='module')
def domain_id():
    with own_domain() as number:
        yield number


@pytest.fixture(scope='module')
def arm(domain_id, tmp_path_factory):
    """Return a client of a graph in lockstep that obeys commands."""
    with obedient_graph(tmp_path_factory.mktemp('graph'), domain_id), MultiContactClient(
            'arm', domain_id=domain_id, timeout=PATIENCE) as client:
        yield client


def reached(arm):
    return arm.wait_until_reached(force_tolerance=0.5, timeout=PATIENCE)


def test_client_presses_moves_and_keeps_pressing(arm):
    arm.set_forces({'table': 5.0, 'board': 4.0})
    reached(arm)
    arm.set_forces({'table': 10.0})
    state = reached(arm)
    assert state.forces_desired == {'table': 10.0, 'board': 4.0}
    assert set(state.noise_variance) == {'table', 'board'}
    goal = state.position_desired + [0.03, 0.0, 0.0]
    arm.move(goal, duration=1.0)
    after = reached(arm)
    np.testing.assert_allclose(after.position_desired, goal, atol=1e-12)
    assert abs(after.position_world[0] - goal[0]) < 0.003
    assert after.time - state.time >= 1.0


def test_client_holds_and_lets_go(arm):
    arm.set_forces({'table': 8.0, 'board': 4.0})
    reached(arm)
    before = arm.read()
    arm.hold()
    # Refused while it is held: neither force nor place is obeyed, and the client says so.
    arm.set_forces({'table': 12.0})
    with pytest.raises(CommandRefusedError, match='contact_forces/command: ~/hold: expected rel'):
        reached(arm)
    with pytest.raises(CommandRefusedError, match='refused: motion/command: ~/hold: expected rel'):
        arm.move(before.position_desired + [0.02, 0.0, 0.0], duration=0.2)
    assert arm.status().refused > 1
    held = arm.read()
    assert held.forces_desired == {'table': 8.0, 'board': 4.0}
    np.testing.assert_allclose(held.position_desired, before.position_world, atol=0.002)
    arm.hold(False)
    arm.set_forces({'table': 12.0})
    assert reached(arm).forces_desired == {'table': 12.0, 'board': 4.0}


def test_client_refuses_contacts_that_are_none_and_says_what_the_controller_refuses(arm):
    with pytest.raises(CommandRefusedError, match='contacts among table, board, found tabel$'):
        arm.set_forces({'tabel': 5.0, 'board': 4.0})
    arm.set_forces({'board': 4.0})
    reached(arm)
    arm.set_forces({'board': 99.0})
    with pytest.raises(CommandRefusedError, match='force on board: expected 0 or 3 to 30 N, fou'):
        reached(arm)
    assert reached(arm).forces_desired['board'] == 4.0
    start = arm.read()
    with pytest.raises(CommandRefusedError, match='motion/command: position x: expected -0.6 to'):
        arm.move(start.position_desired + [2.0, 0.0, 0.0], duration=0.3)
    arm.move(start.position_desired, duration=0.5)
    arm.set_forces({'board': 99.0})
    arm.read()
    while arm.status().last_refusal.startswith('motion'):
        arm.read()
    with pytest.warns(CommandRefusedWarning, match='force on board'):
        arm.set_forces({'board': 4.0})
    reached(arm)


def test_what_is_refused_of_somebody_else_is_not_taken_for_ones_own(arm, domain_id):
    arm.set_forces({'table': 8.0, 'board': 4.0})
    reached(arm)
    with MultiContactClient('arm', domain_id=domain_id, timeout=PATIENCE) as other:
        for force in (99.0, 77.0):
            other.set_forces({'board': force})
            with pytest.raises(CommandRefusedError, match=f'board: .* found {force:g} N'):
                reached(other)
        other.hold()
        other.set_forces({'board': 7.0})
        with pytest.raises(CommandRefusedError, match='~/hold: expected released'):
            reached(other)
        other.hold(False)
    wait_for(lambda: arm.status().refused >= 3, 'all of it')
    assert reached(arm).forces_desired == {'table': 8.0, 'board': 4.0}
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        arm.set_forces({'table': 9.0})
    assert reached(arm).forces_desired == {'table': 9.0, 'board': 4.0}
    assert arm.status().forces == {'table': 9.0, 'board': 4.0}


def stands_still(arm):
    """Tare; return False if the arm still moves."""
    try:
        arm.tare()
    except RunError as error:
        assert 'tare refused: joint speeds: expected at most' in str(error)
        return False
    return True


def test_client_tares_where_nothing_touches_only(arm, domain_id):
    with pytest.raises(RunError, match='tare refused: contacts: expected none under force con'):
        arm.tare()
    state = arm.read()
    arm.set_forces({'table': 0.0, 'board': 0.0})
    arm.move(state.position_world + [0.0, -0.02, 0.02], duration=1.0)
    reached(arm)  # free of both
    with LifecycleDriver(domain_id, namespace='arm') as driver:
        before = get_parameter(driver, 'controller_node', 'tool.bias_sensor')
        wait_for(lambda: stands_still(arm), 'a tare at rest')
        bias = get_parameter(driver, 'controller_node', 'tool.bias_sensor')
    assert bias != before
    np.testing.assert_allclose(bias, before, atol=0.1)  # there is none in this sensor
    assert all(abs(force) < 0.5 for force in arm.read().forces.values())


def test_client_deactivates_and_activates_a_real_controller(arm, domain_id):
    arm.set_forces({'table': 5.0, 'board': 5.0})
    reached(arm)
    with LifecycleDriver(domain_id, namespace='arm') as driver, MultiContactClient(
            'arm', domain_id=domain_id, timeout=1.0) as impatient:
        for _ in range(1):
            for _ in range(2):  # once more makes no difference
                arm.deactivate()
                assert driver.state('controller_node') == 'inactive'
            with pytest.raises(RunError, match='is the controller active'):
                impatient.read()
            with pytest.raises(RunError, match='is the controller active'):
                impatient.set_forces({'table': 5.0})
            with pytest.raises(RunError, match='hold refused: controller: expected active'):
                arm.hold()
            for _ in range(2):
                arm.activate()
                assert driver.state('controller_node') == 'active'
            # What was commanded before is forgotten, by both.
            assert arm.read().forces_desired == {'table': 0.0, 'board': 0.0}
            arm.set_forces({'table': 6.0})
            assert reached(arm).forces_desired == {'table': 6.0, 'board': 0.0}
        for name in ('controller_node', 'noise_estimator_node'):
            for transition in (DEACTIVATE, CLEAN_UP):
                driver.change(name, transition)
    arm.activate()
    arm.set_forces({'table': 5.0, 'board': 5.0})
    state = reached(arm)
    assert set(state.noise_variance) == {'table', 'board'}


def test_client_says_when_nobody_is_there(domain_id):
    with MultiContactClient('nobody', domain_id=domain_id, timeout=0.2) as client:
        for call in (client.read, lambda: client.set_forces({'table': 1.0})):
            with pytest.raises(RunError, match='expected a message within 0.2 s, found none; is'):
                call()
        with pytest.raises(RunError, match='/nobody/controller_node/tare: expected this service'):
            client.tare()


class StandIn:
    """The services of a controller, and what was asked of it."""

    def __init__(self, domain_id):
        self.asked = []
        self.state = 'unconfigured'
        self._guest = GuestNode('controller_node', domain_id, 'stand_in')
        for service, name, callback in (
                (GetState, 'get_state', self._get_state), (Trigger, 'tare', self._tare),
                (ChangeState, 'change_state', self._change), (SetBool, 'hold', self._hold)):
            self._guest.node.create_service(service, f'~/{name}', callback)
        self._executor = SingleThreadedExecutor(context=self._guest.context)
        self._executor.add_node(self._guest.node)
        self._thread = threading.Thread(target=self._executor.spin)
        self._thread.start()

    def publish_poses_that_begin_anew(self, count):
        node, numbers = self._guest.node, itertools.cycle(range(count))
        publisher = create_publisher(node, topics.POSE_DESIRED)
        create_publisher(node, topics.STATUS)
        create_subscription(
            node, topics.MOTION_COMMAND, ignore, topics.MOTION_COMMAND.profile)
        node.create_timer(0.005, lambda: publisher.publish(messages.pose_message(
            1_000_000_000 + 2_000_000 * next(numbers), [0.0, 0.5, 0.5], [0.0, 0.0, 0.0, 1.0],
            'world')))

    def publish_samples_whose_clock_is_set_back(self):
        node, numbers = self._guest.node, itertools.count()
        publishers = {topic: create_publisher(node, topic) for topic in STATE_TOPICS}

        def publish():
            k = next(numbers)
            stamp = 10**12 + 1000 * k if k < 400 else 2_000_000 * k  # ns
            for topic, publisher in publishers.items():
                publisher.publish(messages.pose_message(
                    stamp, [0.0, 0.5, 0.5], [0.0, 0.0, 0.0, 1.0], 'world') if topic in (
                        topics.POSE, topics.POSE_DESIRED) else messages.joint_state_message(
                            stamp, ['table'], effort=[0.0]))

        node.create_timer(0.005, publish)

    def _get_state(self, _request, response):
        response.current_state.label = self.state
        return response

    def _change(self, request, response):
        self.asked.append(request.transition.label)
        self.state = GOALS[request.transition.label]
        response.success = True
        return response

    def _tare(self, _request, response):
        response.message = 'in contact'
        return response

    def _hold(self, request, response):
        self.asked.append(request.data)
        response.success = True
        return response

    def close(self):
        self._executor.shutdown()
        self._thread.join()
        self._guest.close()


def test_client_drives_services_and_lifecycle(domain_id):
    controller = StandIn(domain_id)
    try:
        with MultiContactClient('stand_in', domain_id=domain_id, timeout=PATIENCE) as client:
            client.activate()
            client.activate()
            client.hold()
            client.hold(False)
            client.deactivate()
            client.deactivate()
            client.activate()
            with pytest.raises(RunError, match='controller_node: tare refused: in contact'):
                client.tare()
    finally:
        controller.close()
    assert controller.asked == [
        CONFIGURE, ACTIVATE, True, False, DEACTIVATE, ACTIVATE]


def test_motion_takes_time_and_ends_where_the_samples_begin_anew(arm, domain_id):
    here = arm.read().position_world
    for duration in (0.0, -1.0, float('nan'), float('inf')):
        with pytest.raises(messages.MessageError, match='duration: expected above 0 s, found'):
            arm.move(here, duration)
    controller = StandIn(domain_id)
    try:
        controller.publish_poses_that_begin_anew(count=200)
        with MultiContactClient('stand_in', domain_id=domain_id, timeout=PATIENCE) as client, (
                pytest.raises(RunError, match='samples begin anew')):
            client.move([0.0, 0.5, 0.5], 1e6)
    finally:
        controller.close()


def test_waiting_goes_on_where_the_clock_is_set_back(domain_id):
    controller = StandIn(domain_id)
    try:
        controller.publish_samples_whose_clock_is_set_back()
        with MultiContactClient('stand_in', domain_id=domain_id, timeout=PATIENCE) as client:
            assert client.read().time >= 1000.0
            assert client.wait_until_reached(timeout=20.0).time < 1000.0
    finally:
        controller.close()
