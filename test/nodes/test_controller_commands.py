"""What users tell a running controller: parameters, set-points, tare and hold."""

from fake_arm import FakeArm, PARAMETERS
from geometry_msgs.msg import Transform
from multicontact_control.errors import RunError
from multicontact_control.paths import find_config_folder
import numpy as np
import pytest
from ros_graph import wait_for
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

pytestmark = pytest.mark.ros

NAME = 'controller_node'
NO_FORCE = {'table': 0.0, 'board': 0.0}


@pytest.fixture(scope='module')
def arm(module_middleware):
    """Start one controller for all tests; each leaves it as it was."""
    module_middleware.start(
        'multicontact_control.nodes.controller_node',
        *PARAMETERS,
        'transition.torque_rate:=100.0',
        'transition.blend_time:=0.02',
        files=(find_config_folder() / 'controller.yaml',),
        flags=('--autostart',),
    )
    arm = FakeArm(module_middleware)
    arm.connect()
    for publisher in (arm.force_command, arm.motion_command):
        wait_for(publisher.get_subscription_count, 'commands connected')
    arm.settle()
    return arm


def send_forces(arm, **forces):
    arm.force_command.publish(
        JointState(name=list(forces), effort=map(float, forces.values()))
    )


def send_position(arm, move=(0.0, 0.0, 0.0)):
    """Command a position this far from where the arm is [m]."""
    pose = Transform()
    for part, names, values in (
        (pose.translation, 'xyz', arm.state.pose.position_world + move),
        (pose.rotation, 'xyzw', arm.state.pose.quaternion_xyzw),
    ):
        for name, value in zip(names, values):
            setattr(part, name, float(value))
    arm.motion_command.publish(MultiDOFJointTrajectoryPoint(transforms=[pose]))


def command(arm, **forces):
    """Command forces, press so, and wait until they are desired; the others are 0."""
    send_forces(arm, **forces)
    arm.press(**(NO_FORCE | forces))
    wait_for(
        lambda: arm.step() is not None and arm.forces('desired') == NO_FORCE | forces,
        f'forces {forces}',
    )


def test_gains_change_live_and_hold_begins_without_a_bump(arm, driver):
    command(arm, table=3.0)
    for name, value in (
        ('force.time_constant', 0.05),
        ('motion.natural_frequency', 10.0),
        ('force.damping_rate', 30.0),
        ('force.time_constant', 0.02),
        ('motion.natural_frequency', 30.0),
        ('force.damping_rate', 100.0),
        ('force.law', 'dob'),
        ('force.fed_forward', 'estimate'),
        ('force.law', 'aob'),
        ('force.fed_forward', 'mixed'),
    ):
        before = arm.step()
        driver.set_parameters(NAME, {name: value})
        assert driver.get_parameters(NAME, name) == [value]
        np.testing.assert_array_equal(arm.step(), before)
    assert driver.call_service(
        NAME, SetBool, 'hold', SetBool.Request(data=True)
    ).success
    np.testing.assert_array_equal(arm.step(), before)
    send_forces(arm, table=8.0)
    # A report is made in steps: what is in it may be some samples apart.
    report = arm.diagnostics(
        lambda x: (
            any('~/hold' in key for key in x['messages'][2])
            and float(x['loop'][2]['rate_hz']) > 1.0
            and x['contacts'][2]['held'] == 'True'
        )
    )
    assert report['life cycle'][2]['state'] == 'active'
    loop, (level, _, values) = report['loop'][2], report['inputs']
    assert 0.0 < float(loop['latency_us_p50']) <= float(loop['latency_us_p99'])
    assert (level, values['age_s contact_forces/noise_variance']) == (1, 'none')
    arm.step()
    assert arm.forces('desired') == NO_FORCE | {'table': 3.0}
    assert driver.call_service(
        NAME, SetBool, 'hold', SetBool.Request(data=False)
    ).success
    command(arm, table=0.0)


def test_refused_values_change_nothing(arm, driver):
    before = arm.settle()
    for law, name, value in (
        ('aob', 'force.time_constant', -1.0),
        ('aob', 'motion.damping_ratio', 6.0),
        ('aob', 'force.damping_rate', 'high'),
        ('aob', 'force.input_delay', 0.004),
        ('aob', 'limits.workspace_lower', [-1.0] * 3),
        ('aob', 'tool.bias_sensor', [1.0]),
        ('pi', 'force.pi.filter_cutoff', 1e308),  # for which there is no design
        ('lqg', 'force.lqg.noise_variance', 1e300),
    ):
        driver.set_parameters(NAME, {'force.law': law})
        old = driver.get_parameters(NAME, name)
        with pytest.raises(RunError, match=name.rpartition('.')[0]):
            driver.set_parameters(NAME, {name: value})
        assert driver.get_parameters(NAME, name) == old
        arm.step()
    driver.set_parameters(NAME, {'force.law': 'aob'})
    np.testing.assert_allclose(arm.settle(), before, atol=1e-6)


def test_set_points_are_obeyed_and_the_limits_can_be_moved(arm, driver):
    before = arm.settle()
    send_position(arm, [0.001, 0.0, 0.0])
    wait_for(lambda: np.abs(arm.step() - before).max() > 0.1, 'motion')
    send_position(arm)
    wait_for(lambda: np.abs(arm.step() - before).max() < 1e-6, 'return')
    command(arm, board=4.0)
    send_forces(arm, board=31.0)  # beyond the ceiling
    arm.settle()
    arm.step()
    assert arm.forces('desired') == NO_FORCE | {'board': 4.0}
    driver.set_parameters(NAME, {'command.force_ceiling': 40.0})
    command(arm, table=31.0, board=0.0)
    command(arm, table=0.0)
    driver.set_parameters(NAME, {'command.force_ceiling': 30.0})


def test_tare_makes_the_compensated_wrench_zero_and_is_refused_under_force_control(
    arm, driver
):
    bias = np.array([1.0, -2.0, 3.0, 0.1, 0.0, -0.1])
    arm.wrench = arm.wrench + bias
    arm.settle(120)
    assert max(abs(x) for x in arm.forces('measured').values()) > 1.0
    answer = driver.call_service(NAME, Trigger, 'tare', Trigger.Request())
    assert answer.success, answer.message
    np.testing.assert_allclose(
        *driver.get_parameters(NAME, 'tool.bias_sensor'), bias, atol=1e-9
    )
    arm.settle(120)
    np.testing.assert_allclose(list(arm.forces('measured').values()), 0.0, atol=1e-9)
    arm.wrench = arm.wrench - bias
    driver.set_parameters(NAME, {'tool.bias_sensor': [0.0] * 6})
    arm.settle(120)
    command(arm, table=5.0)
    for service in ('tare', 'retry'):  # and there is nothing that waits for a retry
        answer = driver.call_service(NAME, Trigger, service, Trigger.Request())
        assert not answer.success and answer.message
    command(arm, table=0.0)
