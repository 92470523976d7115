"""The life cycle of the controller: in this process, and as a process."""

from pathlib import Path
import re

from fake_arm import EFFORT, FakeArm, UNFELT
from fake_arm import PARAMETERS as STILL
from multicontact_control.nodes.lifecycle import (
    FAILURE,
    FINALIZED,
    SUCCESS,
    UNCONFIGURED,
)
from multicontact_control.nodes.link import (
    ACTIVATE,
    CONFIGURE,
    DEACTIVATE,
    TransitionError,
)
from multicontact_control.paths import find_config_folder
import numpy as np
import pytest
from rclpy.parameter import Parameter
from ros_graph import end_of

pytestmark = pytest.mark.ros

MODULE = 'multicontact_control.nodes.controller_node'
NAME = 'controller_node'
FILE = find_config_folder() / 'controller.yaml'
RATE, BLEND = 100.0, 0.02  # transition.torque_rate [N m/s], transition.blend_time [s]
PARAMETERS = (
    *STILL,
    f'transition.torque_rate:={RATE}',
    f'transition.blend_time:={BLEND}',
)
LARGEST_STEP = RATE * 0.002 * (1.0 + 1e-9)


def test_controller_goes_through_every_transition_again_and_again(host):
    controller = host.make(*PARAMETERS)
    arm = FakeArm(host)
    gravity = arm.state.gravity
    for _ in range(2):
        assert controller.trigger_configure() == SUCCESS
        arm.send()
        assert controller.trigger_activate() == SUCCESS
        arm.connect()
        assert (
            controller.trigger_deactivate() == controller.trigger_activate() == SUCCESS
        )
        np.testing.assert_array_equal(arm.step(), EFFORT)  # nothing is remembered
        assert 0.0 < np.abs(arm.step() - EFFORT).max() <= LARGEST_STEP
        np.testing.assert_allclose(arm.settle(), gravity, atol=1e-6)
        assert controller.trigger_deactivate() == SUCCESS
        np.testing.assert_allclose(arm.step(), gravity, atol=1e-6)
        assert controller.trigger_cleanup() == SUCCESS
        stamp = arm.send()
        assert controller.state == UNCONFIGURED
        assert not any(arm.answer(stamp) for _ in range(50))
    assert controller.trigger_shutdown() == SUCCESS
    assert controller.state == FINALIZED


def test_sample_that_comes_again_after_a_deactivation_is_answered_by_the_safe_behaviour(
    host,
):
    """The answer to it is lost, and the robot waits for one."""
    controller = host.activate(*PARAMETERS, 'safe_behaviour:=zero_torque')
    arm = FakeArm(host)
    arm.connect()
    torque = arm.settle()
    assert controller.trigger_deactivate() == SUCCESS
    arm.k -= 1
    np.testing.assert_array_equal(arm.step(), torque)  # from where it goes over
    assert 0.0 < np.abs(arm.step() - torque).max() <= LARGEST_STEP


def test_reaction_that_ends_by_a_deactivation_is_not_said_to_end_in_control(
    host, capfd
):
    controller = host.activate('sensor.frozen_ticks:=0', UNFELT, 'patience:=50.0')
    arm = FakeArm(host)
    arm.connect()
    arm.diagnostics(lambda x: x['supervisor'][2]['reaction'] == 'float', host.pause)
    assert controller.trigger_deactivate() == SUCCESS
    arm.connect()
    logged = capfd.readouterr().err
    assert 'float instead of control' in logged
    assert 'control goes on' not in logged.partition('deactivated: ')[2]


def test_process_obeys_possible_transitions_and_leaves_the_arm_safely(
    middleware, driver
):
    process = middleware.start(
        MODULE, *PARAMETERS, 'safe_behaviour:=zero_torque', files=(FILE,)
    )
    for transition in (ACTIVATE, DEACTIVATE):  # not possible yet
        with pytest.raises(TransitionError):
            driver.change_state(NAME, transition)
    assert driver.get_state(NAME) == 'unconfigured'
    for transition in (CONFIGURE, ACTIVATE):
        driver.change_state(NAME, transition)
    # A port in shared memory would outlive a process that is killed, and the next one's be deaf.
    assert '_port' not in Path(f'/proc/{process.pid}/maps').read_text(encoding='utf-8')
    arm = FakeArm(middleware)
    arm.connect()
    torques = [arm.settle()]
    process.terminate()
    while process.poll() is None:
        arm.send()
        middleware.pause()
        command = arm.newest_command()
        if command is not None:
            torques.append(np.array(command.effort))
    assert process.returncode == 0
    first, last = (np.abs(torques[i]).max() for i in (0, -1))
    assert (
        len(torques) < 20 or last < first - LARGEST_STEP
    )  # few: the samples came too late


def test_configure_refuses_what_is_wrong_until_it_is_repaired(host, tmp_path):
    weightless = tmp_path / 'weightless.urdf'
    weightless.write_text(
        re.sub(
            '<inertial>.*?</inertial>',
            '',
            (find_config_folder() / 'puma560.urdf').read_text(),
            flags=re.DOTALL,
        )
    )
    node = host.make(
        'robot.urdf:=nowhere.urdf',
        'rate:=-500.0',
        "effort_output_topic:='bare efforts'",
    )
    for name, value in (
        ('rate', 500.0),
        ('robot.urdf', str(weightless)),
        ('robot.urdf', str(find_config_folder() / 'puma560.urdf')),
        ('effort_output_topic', '~/efforts'),
    ):
        assert node.trigger_configure() == FAILURE
        assert node.state == UNCONFIGURED
        assert node.set_parameters([Parameter(name, value=value)])[0].successful
    assert node.trigger_configure() == SUCCESS


def test_autostart_begins_alone_or_ends_with_the_reason(middleware):
    bad = middleware.start(
        MODULE, 'force.time_constant:=-1.0', files=(FILE,), flags=('--autostart',)
    )
    process = middleware.start(
        MODULE, *PARAMETERS, files=(FILE,), flags=('--autostart',)
    )
    FakeArm(middleware).connect()
    assert process.poll() is None
    _, errors = end_of(bad)
    assert bad.returncode == 2
    assert errors.splitlines()[-1].endswith(
        'force.time_constant: expected greater than 0, got -1.0'
    )
