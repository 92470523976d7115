import numpy as np
import pytest
from sim_bridge.joint_friction import (
    FRICTION,
    friction_slope,
    friction_torque,
    implicit_speed,
    joint_friction,
)
from sim_bridge.puma560 import puma_arm

ROW = np.array([(0.5, 27.0, 25.0, 1e-3)], dtype=FRICTION)[0]
STEP, INERTIA = 2.5e-4, 0.784


def test_joint_friction_refers_friction_to_the_joint(robot):
    """Both b G^2 and F |G|: 24.7 and 27.2 N m on joint 1."""
    table = np.array(joint_friction(puma_arm(robot), 0.6, 1e-3).tolist())
    np.testing.assert_allclose(
        table[0] / 0.6, [1.48e-3 * 62.6111 ** 2, 0.395 * 62.6111, 0.435 * 62.6111, 1e-3 / 0.6])
    assert np.all(table >= 0.0)


def test_friction_slope_is_the_derivative_of_the_torque():
    for speed in (-0.1, -2e-3, -4e-4, 3e-4, 1e-3, 0.5):
        step = 1e-8
        slope = (friction_torque(speed + step, ROW) - friction_torque(speed - step, ROW)) / 2e-8
        assert friction_slope(speed, ROW) == pytest.approx(slope, rel=1e-5)


def test_implicit_speed_solves_its_equation(rng):
    for _ in range(500):
        free = rng.choice([-1, 1]) * 10 ** rng.uniform(-9, 1)
        speed = implicit_speed(free, STEP, INERTIA, ROW)
        residual = speed - free + STEP / INERTIA * friction_torque(speed, ROW)
        assert residual == pytest.approx(0.0, abs=1e-9 * max(1e-3, abs(free)))
        assert min(0.0, free) <= speed <= max(0.0, free)


def test_friction_holds_a_torque_below_coulombs():
    """What an explicit tanh cannot do at this step: come to rest, and stay."""
    speed, travel = 0.05, 0.0
    for tick in range(8000):
        speed = implicit_speed(speed + STEP / INERTIA * 15.0, STEP, INERTIA, ROW)
        travel += STEP * speed if tick >= 4000 else 0.0
    assert speed == pytest.approx(1e-3 * np.arctanh(15.0 / 27.0), rel=0.01)
    assert travel < 1e-3


def test_friction_lets_go_above_coulombs():
    speed = 0.0
    for _ in range(4000):
        speed = implicit_speed(speed + STEP / INERTIA * 28.0, STEP, INERTIA, ROW)
    exact = 1.0 / 0.5 * (1.0 - np.exp(-0.5 / INERTIA))
    assert speed == pytest.approx(exact, rel=0.01)
