"""A supervisor without guards: no jump at its start, when it is retuned, and when it stops."""

from arms import controller_config, HOME, Law, Measurement
from multicontact_control.control.tasks import CommandedTask
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.paths import config_dir
from multicontact_control.sensor.tool import weight_reading
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
from multicontact_control.supervision.supervisor import Supervisor
import numpy as np
import pytest

R = np.full(2, 0.6)
REST = np.zeros(6)
EFFORT = np.array([1.0, -30.0, 5.0, 0.5, 0.5, 0.1])


def make(**changes):
    config = controller_config(**changes)
    reference = CommandedTask(config.contact_names)
    robot = RobotModel(config.robot, config_dir())
    return Supervisor(config, robot, reference, guarded=False), reference


def sample(controller, k=0, *, effort=None, q=HOME, qd=REST):
    """Return a sample without contact."""
    state = controller.controller.robot.update(q, qd)
    config = controller.config
    wrench = weight_reading(
        state.sensor_pose.rotation_world, config.tool, np.array(config.robot.gravity_world))
    time = k * config.period
    return TickInputs(time, JointInput(time, np.array(q), np.array(qd), effort=effort),
                      WrenchInput(time, wrench), VarianceInput(time, R))


def gravity(controller):
    return controller.controller.robot.update(HOME, REST).gravity


@pytest.mark.parametrize('effort', [EFFORT, None, np.full(6, np.nan), np.zeros(6)])
def test_first_command_is_the_measured_effort_or_gravity_compensation(effort):
    controller, _ = make()
    for k in range(5):
        output = controller.step(sample(controller, k, effort=effort))[0]
        if k == 0:
            np.testing.assert_array_equal(
                output.torque, EFFORT if effort is EFFORT else gravity(controller))
    controller.reset()
    output = controller.step(sample(controller, effort=-EFFORT))[0]
    np.testing.assert_array_equal(output.torque, -EFFORT)


def test_torque_is_that_of_the_law_after_the_blend():
    controller, _ = make(transition={'blend_time': 0.02, 'torque_rate': 1e5})
    law = Law(controller.config, CommandedTask(controller.config.contact_names))
    for k in range(12):
        output = controller.step(sample(controller, k, effort=EFFORT))[0]
        joints, wrench = sample(controller, k)[1:3]
        expected = law.step(Measurement(joints.stamp, joints.q, joints.qd, wrench.wrench), R)
        equal = np.array_equal(output.torque, expected.torque)
        assert equal == (k >= 10), k


def test_reconfigure_repeats_the_last_command_and_then_keeps_to_the_rate():
    controller, _ = make(transition={'torque_rate': 50.0, 'blend_time': 0.0})
    away = HOME + 0.01  # from the pose at the start, which is held
    controller.step(sample(controller))
    for k in range(1, 300):
        before = controller.step(sample(controller, k, q=away))[0]
    stiffer = controller_config(
        transition={'torque_rate': 50.0, 'blend_time': 0.0}, motion={'natural_frequency': 60.0})
    controller.reconfigure(stiffer)
    after = [controller.step(sample(controller, k, q=away))[0].torque
             for k in range(300, 2300)]
    np.testing.assert_array_equal(after[0], before.torque)
    steps = np.abs(np.diff([before.torque, *after], axis=0))
    assert 0.0 < steps.max() <= 50.0 * controller.config.period * (1.0 + 1e-9)
    assert np.abs(after[-1] - before.torque).max() > 1.0


def test_reconfigure_keeps_what_the_observers_know():
    controller, reference = make()
    for k in range(50):
        if k == 1:
            reference.set_forces({'table': 5.0})
        controller.step(sample(controller, k))
    known = controller.controller.laws['observer']
    assert known['x_est'][0].any()
    controller.reconfigure(controller_config(force={'time_constant': 0.04}))
    new = controller.controller.laws['observer']
    np.testing.assert_array_equal(known['x_est'], new['x_est'])
    np.testing.assert_array_equal(known['P'], new['P'])
    np.testing.assert_array_equal(known['running'], new['running'])
    assert (new['feedback'][:, 0] < 0.5 * known['feedback'][:, 0]).all()
    # The input under way is still the one that was commanded.
    np.testing.assert_allclose(
        new['command'] - np.sum(new['feedback'] * new['x_est'], axis=1),
        known['command'] - np.sum(known['feedback'] * known['x_est'], axis=1),
        rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize('kind', ['gravity_compensation', 'zero_torque', 'hold_position'])
def test_stop_goes_from_the_last_command_to_the_declared_behaviour(kind):
    controller, _ = make(safe_behaviour=kind)
    last = controller.step(sample(controller, effort=EFFORT))[0].torque
    controller.stop()
    torques = [controller.step(sample(controller, k))[0].torque for k in range(1, 1200)]
    np.testing.assert_array_equal(torques[0], last)
    rate = controller.config.transition.torque_rate
    assert np.abs(np.diff(torques, axis=0)).max() <= rate * 0.002 * (1.0 + 1e-9)
    expected = 0.0 * EFFORT if kind == 'zero_torque' else gravity(controller)
    np.testing.assert_allclose(torques[-1], expected, atol=1e-9)


def test_safe_behaviour_answers_a_push_as_declared():
    """A joint that is pushed away is braked, and pulled back only if the posture is held."""
    for kind, pulls in (('gravity_compensation', False), ('hold_position', True)):
        controller, _ = make(safe_behaviour=kind, transition={'blend_time': 0.0})
        controller.stop()
        for k in range(3):
            controller.step(sample(controller, k))
        moved = HOME + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.05])
        back = controller.step(sample(controller, 3, q=moved))[0].torque[5]
        weight = controller.controller.robot.update(moved, REST).gravity[5]
        assert (back < weight - 0.1) == pulls
        moving = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        assert controller.step(sample(controller, 4, qd=moving))[0].torque[5] < -0.1


def of_table(**changes):
    contacts = {name: x.model_dump() for name, x in controller_config().contacts.items()}
    contacts['table'].update(changes)
    return controller_config(contacts=contacts)


def test_normal_that_was_found_is_kept_until_another_is_told():
    turning, found = {'normal_turn_rate': 0.2, 'friction_std': 2.0}, [0.1, 0.0, -np.sqrt(0.99)]
    other = [0.0, 0.6, -0.8]
    controller, _ = make(contacts=of_table(**turning).model_dump()['contacts'])
    controller.step(sample(controller))
    normals = controller.controller.contacts['normal']
    for changes, normal in (
            ({**turning, 'friction_coefficient': 0.1}, found),
            ({**turning, 'normal_world': other}, other),
            ({'friction_std': 2.0, 'normal_world': other}, other)):
        normals[0] = found
        controller.reconfigure(of_table(**changes))
        np.testing.assert_allclose(controller.controller.contacts['normal'][0], normal)
