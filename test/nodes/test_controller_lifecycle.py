"""The life cycle of the controller, as a process."""

from __future__ import annotations

import re
from types import SimpleNamespace

from fake_arm import EFFORT, FakeArm
from fake_arm import PARAMETERS as STILL
from multicontact_control.nodes import controller_node
from multicontact_control.nodes.link import (
    ACTIVATE,
    CLEAN_UP,
    CONFIGURE,
    DEACTIVATE,
    LifecycleDriver,
    SHUT_DOWN,
    TransitionError,
)
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from ros_graph import end_of, PATIENCE, set_parameter

pytestmark = pytest.mark.ros

MODULE = 'multicontact_control.nodes.controller_node'
NAME = 'controller_node'
FILE = config_dir() / 'controller.yaml'
RATE, BLEND = 100.0, 0.02  # transition.torque_rate [N m/s], transition.blend_time [s]
PARAMETERS = (*STILL, f'transition.torque_rate:={RATE}', f'transition.blend_time:={BLEND}')
LARGEST_STEP = RATE * 0.002 * (1.0 + 1e-9)


@pytest.fixture
def driver(domain_id, middleware):
    with LifecycleDriver(domain_id) as handle:
        yield handle


@pytest.fixture
def process(middleware):
    return middleware.start(MODULE, *PARAMETERS, files=(FILE,))


@pytest.fixture
def arm(middleware):
    return FakeArm(middleware)


def settle(arm):
    for _ in range(60):
        torque = arm.step()
    return torque


def test_every_transition_works_again_and_again(process, driver, arm):
    gravity = arm.state.gravity
    for _ in range(2):
        driver.change(NAME, CONFIGURE)
        arm.send()
        driver.change(NAME, ACTIVATE)
        arm.connect()
        for _ in range(2):
            driver.change(NAME, DEACTIVATE)
            driver.change(NAME, ACTIVATE)
            np.testing.assert_array_equal(arm.step(), EFFORT)  # nothing is remembered
            second = arm.step()
            assert 0.0 < np.abs(second - EFFORT).max() <= LARGEST_STEP
            np.testing.assert_allclose(settle(arm), gravity, atol=1e-6)
            driver.change(NAME, DEACTIVATE)
            np.testing.assert_allclose(arm.step(), gravity, atol=1e-6)
            driver.change(NAME, ACTIVATE)
            arm.step()
        driver.change(NAME, DEACTIVATE)
        driver.change(NAME, CLEAN_UP)
        stamp = arm.send()
        assert driver.state(NAME) == 'unconfigured'
        assert arm.answer(stamp) is None
    driver.change(NAME, SHUT_DOWN)
    assert process.wait(PATIENCE) == 0


def test_a_transition_that_is_not_possible_is_refused_and_survived(process, driver):
    for transition in (ACTIVATE, DEACTIVATE, CLEAN_UP):
        with pytest.raises(TransitionError, match=f'{NAME} refused to {transition}'):
            driver.change(NAME, transition)
    assert driver.state(NAME) == 'unconfigured'
    driver.change(NAME, CONFIGURE)
    driver.change(NAME, SHUT_DOWN)
    assert process.wait(PATIENCE) == 0


def test_deactivation_goes_to_the_declared_behaviour_without_a_jump(process, driver, arm):
    for transition in (CONFIGURE, ACTIVATE):
        driver.change(NAME, transition)
    arm.connect()
    assert set_parameter(driver, NAME, 'safe_behaviour.kind', 'zero_torque').successful
    last = settle(arm)
    driver.change(NAME, DEACTIVATE)
    torques = [last] + [arm.step() for _ in range(300)]
    np.testing.assert_array_equal(torques[1], last)
    assert np.abs(np.diff(torques, axis=0)).max() <= LARGEST_STEP
    assert np.abs(torques[-1]).max() < 0.5 * np.abs(last).max()


def test_configure_refuses_a_topic_that_cannot_be(middleware, driver):
    process = middleware.start(MODULE, "effort_output_topic:='bare efforts'", files=(FILE,))
    with pytest.raises(TransitionError):
        driver.change(NAME, CONFIGURE)
    assert set_parameter(driver, NAME, 'effort_output_topic', '~/efforts').successful
    driver.change(NAME, CONFIGURE)
    process.kill()
    errors = process.communicate()[1]
    assert ("cannot configure: effort_output_topic: expected a name of a topic, found 'bare "
            "efforts' (topic name must not contain") in errors
    assert 'Traceback' not in errors


def test_process_that_is_told_to_end_leaves_the_arm_in_the_declared_behaviour(
        process, middleware, driver, arm):
    for transition in (CONFIGURE, ACTIVATE):
        driver.change(NAME, transition)
    arm.connect()
    assert set_parameter(driver, NAME, 'safe_behaviour.kind', 'zero_torque').successful
    torques = [settle(arm)]
    process.terminate()
    while process.poll() is None:
        arm.send()
        middleware.pause()
        command = arm.newest_command()
        if command is not None:
            torques.append(np.array(command.effort))
    assert process.returncode == 0
    assert np.abs(torques[-1]).max() < np.abs(torques[0]).max() - 5 * LARGEST_STEP


@pytest.mark.parametrize(('silent', 'expected'), [(0.0, 0.5), (0.2, 0.3), (0.6, 0.0)])
def test_robot_that_stalls_is_waited_for_and_one_that_has_gone_is_not(
        monkeypatch, silent, expected):
    """The last sample came a while before the end, and then none; by a clock of its own."""
    now = [10 ** 12]
    monkeypatch.setattr(
        controller_node, 'time', SimpleNamespace(monotonic_ns=lambda: now[0]))
    start = now[0]

    def spin_once(spinner):
        now[0] += 10 ** 6

    node = SimpleNamespace(
        working=True, trigger_deactivate=lambda: None, spin_once=spin_once,
        _last_taken=start - round(silent * 1e9))
    controller_node.ControllerNode.take_leave(node, None)
    assert (now[0] - start) * 1e-9 == pytest.approx(expected)


def test_configure_refuses_what_is_wrong_in_one_line_until_it_is_repaired(middleware, driver):
    process = middleware.start(MODULE, 'robot.urdf:=nowhere.urdf', 'rate:=-500.0', files=(FILE,))
    with pytest.raises(TransitionError):
        driver.change(NAME, CONFIGURE)
    assert set_parameter(driver, NAME, 'rate', 500.0).successful
    with pytest.raises(TransitionError):
        driver.change(NAME, CONFIGURE)
    assert driver.state(NAME) == 'unconfigured'
    assert set_parameter(driver, NAME, 'robot.urdf', 'puma560.urdf').successful
    driver.change(NAME, CONFIGURE)
    assert driver.state(NAME) == 'inactive'
    process.kill()
    reasons = re.findall('cannot configure: (.*)', process.communicate()[1])
    assert [reason.split(':')[0] for reason in reasons] == ['rate', 'robot.urdf']


def test_autostart_begins_alone_or_ends_with_the_reason(middleware, arm):
    bad = middleware.start(
        MODULE, 'force.time_constant:=-1.0', files=(FILE,), flags=('--autostart',))
    process = middleware.start(MODULE, 'autostart:=true', *PARAMETERS, files=(FILE,))
    arm.connect()
    assert process.poll() is None
    _, errors = end_of(bad)
    assert bad.returncode == 2
    assert errors.splitlines()[-1].endswith(
        'force.time_constant: expected greater than 0, found -1.0')
