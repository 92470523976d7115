"""The state of the arm: alarms, residuals, friction that is learnt, touches that pass."""

from arms import controller_config, HOME
from multicontact_control.control.arm import (
    ArmState,
    detect_passed_touch,
    learn_friction,
    update_residual,
)
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.flags import OPERATIONAL_SPEED, RESIDUAL_EXCEEDED
from multicontact_control.paths import find_config_folder
from multicontact_control.records import CONTACT, CONTROL, JOINT
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

H = 0.002
ROBOT = RobotModel(controller_config().robot, find_config_folder())
REST = np.zeros(6)


def make_arm(**momentum):
    """Return an arm without contacts, whose momentum observer is set."""
    controls = np.zeros(1, dtype=CONTROL)
    controls['law']['friction_speed'] = 0.1
    for name, value in momentum.items():
        controls['momentum']['config'][name] = value
    return ArmState(ROBOT, controls, np.zeros(0, dtype=CONTACT))


def put(arm, q=HOME, velocity=REST):
    arm.motion[:] = q, velocity
    return arm.take_motion()


def turning(speed):
    """Return joint velocities by which the tool turns at a speed [rad/s]."""
    velocity = np.array([0.1, -0.2, 0.1, 0.5, 0.4, -0.3])
    turn = ROBOT.update(HOME, velocity).twist_world[3:]
    return velocity * speed / np.linalg.norm(turn)


@pytest.mark.parametrize(('limit', 'found'), [(2.1, 0), (1.9, OPERATIONAL_SPEED)])
def test_arm_that_turns_too_fast_is_seen_all_the_same(limit, found):
    arm = make_arm()
    arm.frames['config']['turn_limit'] = limit
    assert put(arm, velocity=turning(2.0))
    assert arm.flags == found
    assert_array_equal(arm.velocity, turning(2.0))


def test_arm_without_limits_is_never_too_fast():
    arm = make_arm()
    put(arm, velocity=turning(50.0))
    assert arm.flags == 0


def test_residual_goes_to_the_torque_that_friction_and_model_leave():
    controls = np.zeros(1, dtype=CONTROL)
    controls['law']['friction_speed'] = 0.1
    controls['momentum']['elapsed'] = H
    joints = np.zeros(1, dtype=JOINT)
    joints['config']['coulomb'] = 1.5
    joints['config']['viscous'] = 2.0
    joints['velocity'] = 0.5
    joints['bias_torque'] = 6.0
    joints['watch']['previous_bias_torque'] = 4.0
    friction = 1.5 * np.tanh(0.5 / 0.1) + 2.0 * 0.5
    joints['watch']['effort'] = 0.9 + 3.0 + 5.0 + 7.0 + friction
    update_residual(controls[0], joints[0], 0.5, 3.0, 7.0)
    assert joints['watch']['residual'][0] == pytest.approx(0.5 * 0.9)
    update_residual(controls[0], joints[0], 0.5, 3.0, 7.0)
    assert joints['watch']['residual'][0] == pytest.approx(0.75 * 0.9)


def test_torque_that_is_not_known_leaves_the_residual():
    controls = np.zeros(1, dtype=CONTROL)
    controls['law']['friction_speed'] = 0.1
    joints = np.zeros(1, dtype=JOINT)
    joints['watch']['residual'] = 0.7
    joints['watch']['effort'] = np.nan
    update_residual(controls[0], joints[0], 0.5, 0.0, 0.0)
    joints['watch']['effort'] = 100.0
    joints['watch']['unwatched'] = True
    update_residual(controls[0], joints[0], 0.5, 0.0, 0.0)
    assert joints['watch']['residual'][0] == 0.7


def test_residual_counts_until_it_falls_below_half_its_threshold():
    arm = make_arm(bandwidth=200.0)
    arm.joints['watch']['threshold'] = 2.0
    gravity = ROBOT.update(HOME, REST).gravity

    def exceeded(touch):
        """Return whether it counts once it has settled at a touch of the second joint."""
        arm.joints['watch']['effort'] = gravity
        arm.joints['watch']['effort'][1] += touch
        for _ in range(50):
            put(arm)
            arm.controls['momentum']['elapsed'] = H
        return bool(arm.flags & RESIDUAL_EXCEEDED)

    assert [exceeded(touch) for touch in (1.9, 2.1, 1.1, 0.9, 1.9)] == [
        False,
        True,
        True,
        False,
        False,
    ]


def test_wrench_of_the_residual_is_its_dynamically_consistent_one():
    """In the axes of the sensor: f = Lambda J M^-1 r."""
    arm = make_arm(bandwidth=200.0, is_input=True)
    residual = np.array([1.0, -2.0, 3.0, 0.4, -0.5, 0.6])
    arm.joints['watch']['residual'] = residual
    q = HOME + np.linspace(
        0.1, 0.6, 6
    )  # at home the sensor's axes are their own inverse
    put(arm, q)
    state = ROBOT.update(q, REST)
    J = state.jacobian
    inverse = np.linalg.inv(state.mass_matrix)
    wrench = np.linalg.solve(J @ inverse @ J.T, J @ inverse @ residual)
    R = state.sensor_pose.rotation_world
    expected = np.concatenate([R.T @ wrench[:3], R.T @ wrench[3:]])
    assert_allclose(arm.controls['wrench'][0], expected, rtol=1e-9)


@pytest.mark.parametrize(('residual', 'learnt'), [(1.5, 1.5), (-1.5, 0.5), (50.0, 2.0)])
def test_friction_along_the_motion_raises_the_threshold_up_to_its_limit(
    residual, learnt
):
    """From what is declared, 0.5 N m, to 2 N m; against the motion it is no friction."""
    controls = np.zeros(1, dtype=CONTROL)
    joints = np.zeros(1, dtype=JOINT)
    controls['momentum']['elapsed'] = H
    config = joints['config']
    config['least_threshold'] = 1.0
    config['declared_friction'] = 0.5
    config['learnt_friction_limit'] = 2.0
    joints['watch']['residual'] = residual
    joints['watch']['residual_statistics']['time_at_rest'] = 1.0
    for _ in range(500):
        learn_friction(controls['momentum'][0], joints[0], 0.1, 1.0, 0.0, 0.0)
    assert joints['watch']['threshold'][0] == pytest.approx(1.0 + learnt, abs=0.3)


def test_touch_has_passed_once_all_residuals_are_small_for_a_while():
    """A quarter of the threshold for 0.1 s, of either sign; told once."""
    momenta = np.zeros(1, dtype=CONTROL)['momentum']
    joints = np.zeros(2, dtype=JOINT)
    momenta['elapsed'] = H
    joints['watch']['threshold'] = 1.0

    def passes(residual, seconds):
        """Return how often a touch has passed while the second joint has a residual."""
        joints['watch']['residual'][1] = residual
        return sum(
            detect_passed_touch(momenta[0], joints) for _ in range(round(seconds / H))
        )

    assert passes(-0.2, 1.0) == 0  # nothing touched
    momenta['collided'] = True
    assert passes(-2.0, 0.1) == 0
    momenta['collided'] = False
    assert passes(-0.3, 1.0) == 0
    assert passes(-0.2, 0.09) == 0
    assert passes(-0.2, 1.0) == 1
