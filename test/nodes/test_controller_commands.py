"""What users tell a running controller: parameters, set-points, tare and hold."""

from __future__ import annotations

from builtin_interfaces.msg import Duration
from fake_arm import FakeArm, PARAMETERS
from geometry_msgs.msg import Transform
from multicontact_control.nodes import qos, topics
from multicontact_control.nodes.graph import ignore, take
from multicontact_control.nodes.link import GuestNode
from multicontact_control.nodes.status import ControllerStatus
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from ros_graph import get_parameter, Middleware, set_parameter, wait_for
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

pytestmark = pytest.mark.ros

NAME = 'controller_node'
RATE = 100.0  # transition.torque_rate [N m/s]


@pytest.fixture(scope='module')
def graph(domain_id, tmp_path_factory):
    """Start one controller for all tests; each leaves it as it was."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_DOMAIN_ID', str(domain_id))
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        patch.setenv('ROS_LOG_DIR', str(tmp_path_factory.mktemp('ros')))
        with Middleware(domain_id) as middleware, GuestNode('driver', domain_id) as driver:
            middleware.start(
                'multicontact_control.nodes.controller_node', 'autostart:=true',
                *PARAMETERS, f'transition.torque_rate:={RATE}', 'transition.blend_time:=0.02',
                files=(config_dir() / 'controller.yaml',))
            arm = FakeArm(middleware)
            arm.connect()
            for publisher in (arm.force_command, arm.motion_command):
                wait_for(publisher.get_subscription_count, 'commands connected')
            arm.statuses = middleware.node.create_subscription(
                topics.STATUS.message, topics.STATUS.name, ignore, qos.STREAM)
            wait_for(lambda: take(arm.statuses), 'a status')
            settle(arm)
            yield arm, driver


def settle(arm):
    for _ in range(60):
        torque = arm.step()
    return torque


def send_forces(arm, names, efforts, identifier=''):
    message = JointState(name=names, effort=[float(x) for x in efforts])
    message.header.frame_id = identifier
    arm.force_command.publish(message)


def send_position(arm, position, identifier=0):
    pose = Transform()
    pose.translation.x, pose.translation.y, pose.translation.z = (float(x) for x in position)
    x, y, z, w = arm.state.pose.quaternion_xyzw.tolist()
    pose.rotation.x, pose.rotation.y, pose.rotation.z, pose.rotation.w = x, y, z, w
    arm.motion_command.publish(MultiDOFJointTrajectoryPoint(
        transforms=[pose], time_from_start=Duration(sec=identifier)))


def command(arm, **forces):
    """Command forces, press so, and wait until they are desired; the others are 0."""
    send_forces(arm, list(forces), forces.values())
    wanted = {'table': 0.0, 'board': 0.0} | forces
    arm.press(**wanted)
    wait_for(lambda: arm.step() is not None and arm.desired() == wanted, f'forces {wanted}')


def refusals(report, source):
    """Return the counts of refused messages by cause."""
    return {key: int(value) for key, value in report['messages'][2].items()
            if key.startswith(f'refused {source}')}


def test_gains_change_live_without_a_bump(graph):
    arm, driver = graph
    command(arm, table=3.0)
    for name, value in (('force.time_constant', 0.05), ('motion.natural_frequency', 10.0),
                        ('force.damping_rate', 30.0), ('force.time_constant', 0.02),
                        ('motion.natural_frequency', 30.0), ('force.damping_rate', 100.0),
                        ('force.law', 'dob'), ('force.fed_forward', 'estimate'),
                        ('force.law', 'aob'), ('force.fed_forward', 'mixed')):
        before = arm.step()
        assert set_parameter(driver, NAME, name, value).successful
        assert get_parameter(driver, NAME, name) == value
        np.testing.assert_array_equal(arm.step(), before)
    command(arm, table=0.0)


def test_refused_values_change_nothing(graph):
    arm, driver = graph
    before = settle(arm)
    for name, value in (
            ('force.time_constant', -1.0), ('motion.damping_ratio', 6.0),
            ('force.damping_rate', 'high'), ('force.input_delay', 0.004),
            ('limits.workspace_lower', [-1.0] * 3), ('tool.bias_sensor', [1.0])):
        old = get_parameter(driver, NAME, name)
        result = set_parameter(driver, NAME, name, value)
        assert not result.successful and result.reason
        assert get_parameter(driver, NAME, name) == old
    np.testing.assert_allclose(arm.step(), before, atol=1e-9)


def test_set_points_are_obeyed_and_the_limits_can_be_moved(graph):
    arm, driver = graph
    command(arm, board=4.0)
    send_forces(arm, ['board'], [31.0])  # beyond the ceiling
    assert set_parameter(driver, NAME, 'command.force_ceiling', 40.0).successful
    command(arm, table=31.0, board=0.0)
    command(arm, table=0.0)
    assert set_parameter(driver, NAME, 'command.force_ceiling', 30.0).successful


def test_commands_are_refused_and_counted_by_cause(graph):
    arm, _ = graph
    position = arm.state.pose.position_world
    before = settle(arm)
    for _ in range(3):
        send_forces(arm, ['wall'], [1.0])
        send_forces(arm, ['table'], [float('nan')])
        send_forces(arm, ['table'], [99.0])
        send_position(arm, position + 5.0)
        send_position(arm, position * np.nan)
    report = arm.diagnostics(
        lambda x: sum(refusals(x, 'contact_forces/command').values()) >= 9
        and sum(refusals(x, 'motion/command').values()) >= 6)
    counts = {**refusals(report, 'contact_forces/command'), **refusals(report, 'motion/command')}
    for cause in ('name: expected distinct names', 'effort: expected finite',
                  'position x: expected -0.6 to 0.6 m', 'translation: expected finite'):
        assert [n for key, n in counts.items() if cause in key] == [3], cause
    np.testing.assert_allclose(settle(arm), before, atol=1e-6)
    assert arm.desired() == {'table': 0.0, 'board': 0.0}


def answers(arm, last):
    """Return command, event and text of each answer on ~/status up to that for a command."""
    found = []

    def heard():
        while (taken := take(arm.statuses)) is not None:
            status = ControllerStatus.of(taken[0])
            if status.event != 'state':
                found.append((status.command, status.event, status.text))
        return found and found[-1][0] == last

    wait_for(heard, f'an answer to {last}', lambda: found)
    return found


def test_commands_are_answered_by_identifier_and_without_one_if_refused(graph):
    arm, _ = graph
    position = arm.state.pose.position_world
    while take(arm.statuses) is not None:
        pass
    send_forces(arm, ['table'], [0.0])
    send_forces(arm, ['table'], [0.0], 'first, of "α" ')
    send_forces(arm, ['table'], [99.0], 'second')
    send_forces(arm, ['wall'], [1.0])
    send_forces(arm, ['board'], [0.0], 'third')
    found = answers(arm, 'third')
    assert [x[:2] for x in found] == [
        ('first, of "α" ', 'accepted'), ('second', 'refused'), ('', 'refused'),
        ('third', 'accepted')]
    assert 'force on table: expected 0 or 3 to 30 N' in found[1][2]
    assert 'name: expected distinct names' in found[2][2]
    for _ in range(20):  # equal answers follow each other at 10 Hz at most
        send_position(arm, position, 7)
    send_position(arm, position)
    send_position(arm, position + 5.0, 7)
    send_position(arm, position, 2**31 - 1)
    found = answers(arm, str(2**31 - 1))
    assert [x[:2] for x in found if x != found[0]] == [
        ('7', 'refused'), (str(2**31 - 1), 'accepted')]
    assert found[0][:2] == ('7', 'accepted') and len(found) < 10


def test_a_commanded_motion_moves_the_torque(graph):
    arm, _ = graph
    position = arm.state.pose.position_world
    before = settle(arm)
    send_position(arm, position + np.array([0.001, 0.0, 0.0]))
    wait_for(lambda: np.abs(arm.step() - before).max() > 0.1, 'motion')
    send_position(arm, position)
    wait_for(lambda: np.abs(arm.step() - before).max() < 1e-6, 'return')
    np.testing.assert_allclose(settle(arm), before, atol=1e-6)


def test_tare_makes_the_compensated_wrench_zero_and_is_refused_under_force_control(graph):
    arm, driver = graph
    bias = np.array([1.0, -2.0, 3.0, 0.1, 0.0, -0.1])
    arm.wrench = arm.wrench + bias
    for _ in range(120):
        arm.step()
    assert max(abs(x) for x in arm.measured().values()) > 1.0
    answer = driver.call(NAME, Trigger, 'tare', Trigger.Request())
    assert answer.success, answer.message
    np.testing.assert_allclose(
        get_parameter(driver, NAME, 'tool.bias_sensor'), bias, atol=1e-9)
    settle(arm)
    np.testing.assert_allclose(list(arm.measured().values()), 0.0, atol=1e-9)
    arm.wrench = arm.wrench - bias
    assert set_parameter(driver, NAME, 'tool.bias_sensor', [0.0] * 6).successful
    for _ in range(120):
        arm.step()
    command(arm, table=5.0)
    # Refused under force control; and there is nothing that waits for a retry.
    for service in ('tare', 'retry'):
        answer = driver.call(NAME, Trigger, service, Trigger.Request())
        assert not answer.success and answer.message
    command(arm, table=0.0)


def test_gains_that_no_law_can_be_designed_for_are_refused(graph):
    arm, driver = graph
    for law, name, good, bad in (('pi', 'force.pi.filter_cutoff', 40.0, 1e308),
                                 ('lqg', 'force.lqg.noise_variance', 1.0, 1e300)):
        assert set_parameter(driver, NAME, 'force.law', law).successful
        assert set_parameter(driver, NAME, name, good).successful
        assert not set_parameter(driver, NAME, name, bad).successful
        assert get_parameter(driver, NAME, name) == good
        arm.step()
    assert set_parameter(driver, NAME, 'force.law', 'aob').successful


def test_hold_keeps_what_is_until_it_is_released(graph):
    arm, driver = graph
    command(arm, table=5.0)
    before = arm.step()
    assert driver.call(NAME, SetBool, 'hold', SetBool.Request(data=True)).success
    np.testing.assert_array_equal(arm.step(), before)
    send_forces(arm, ['table'], [5.0])
    report = arm.diagnostics(lambda x: any('~/hold' in key for key in x['messages'][2]))
    assert report['contacts'][2]['held'] == 'True'
    arm.step()
    assert arm.desired() == {'table': 5.0, 'board': 0.0}
    assert driver.call(NAME, SetBool, 'hold', SetBool.Request(data=False)).success
    command(arm, table=0.0)


def test_diagnostics_report_loop_inputs_and_contacts(graph):
    arm, _ = graph
    report = arm.diagnostics(lambda x: float(x['loop'][2]['rate_hz']) > 1.0)
    assert report['life cycle'][2]['state'] == 'active'
    loop = report['loop'][2]
    assert 0.0 < float(loop['latency_us_p50']) <= float(loop['latency_us_p99'])
    assert float(loop['jitter_us_p50']) <= float(loop['jitter_us_p99'])
    assert report['contacts'][2]['table'] == 'free'
    level, text, values = report['inputs']
    assert (level, values['age_s contact_forces/noise_variance']) == (1, 'none')
    assert 'contact_forces/noise_variance' in text
    assert float(values['age_s joint_states']) < 60.0
