"""The push test of the simulated arm, whose sensor is mounted wrongly."""

from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
from multicontact_control.sensor.push_test import PushTestConfig
from multicontact_control.sensor.tool import TareConfig
import numpy as np
import pytest

CONFIG = PushTestConfig(settle_time=0.2, hold_time=0.2)
LENGTH, GAP = CONFIG.settle_time + CONFIG.hold_time + 0.2, 0.8  # s, of a push and between two


@pytest.mark.parametrize(('plant', 'mounting', 'verdict'), [
    ('puma', np.eye(3), 'passed'), ('puma', -np.eye(3), 'sign flipped'),
    ('rigid', 0.5 * np.eye(3), 'scale 0.5'),
    ('rigid', [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], "rotated by 90 deg about the sensor's y"),
    ('puma', [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "rotated by -90 deg about the sensor's z")])
def test_push_test_names_the_fault_of_the_mounting(plant, mounting, verdict):
    """Tared first, so that nothing is wrong at rest."""
    count = len(CONFIG.directions)
    loop = ClosedLoop(resolve('quick', plant=plant, plant_overrides={
        'sensor': {'mounting': np.ravel(mounting).tolist(), 'bias': [3.0, -2.0, 4.0, 0, 0.1, 0]},
        'tool_push_start': [1.0 + i * (LENGTH + GAP) for i in range(count)],
        'tool_push_duration': [LENGTH] * count,
        'tool_push_force_world': (CONFIG.force * CONFIG.directions_world).ravel().tolist()},
        controller={'sensor': {'require_push_test': True}}))
    control, gate = loop.control, loop.control.push_gate
    for _ in range(150):
        loop.advance()
    tool = control.config.tool.model_copy(
        update={'bias_sensor': tuple(control.tare(TareConfig()).tolist())})
    control.supervisor.reconfigure(control.config.model_copy(update={'tool': tool}))
    control.push_test(CONFIG, loop.plant.tool_push_point)
    while gate.result is None:
        loop.advance()
    loop.close()
    assert verdict in gate.result.message
    assert gate.result.passed is (verdict == 'passed')
