"""The push test of the simulated arm, whose sensor is mounted wrongly."""

import itertools

from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
from multicontact_control.sensor.push_test import PushTestConfig
from multicontact_control.sensor.tool import TareConfig
import numpy as np
import pytest
from sim_bridge.arm import SENSOR_FRAME

CONFIG = PushTestConfig(settle_time=0.2, hold_time=0.2)
LENGTH, GAP = CONFIG.settle_time + CONFIG.hold_time + 0.2, 0.8  # s, of a push and between two


@pytest.mark.parametrize(('plant', 'mounting', 'verdict'), [
    ('puma', np.eye(3), 'passed'), ('puma', -np.eye(3), 'sign flipped'),
    ('rigid', 0.5 * np.eye(3), 'scale 0.5'),
    ('rigid', [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], "rotated by 90 deg about the sensor's y"),
    ('puma', [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "rotated by -90 deg about the sensor's z")])
def test_push_test_names_the_fault_of_the_mounting(plant, mounting, verdict):
    """Tared first, so that nothing is wrong at rest."""
    pushes = dict(zip((500 + round(500 * i * (LENGTH + GAP)) for i in itertools.count()),
                      CONFIG.force * CONFIG.directions_world))
    loop = ClosedLoop(resolve('quick', plant=plant, plant_overrides={
        'sensor': {'mounting': np.ravel(mounting).tolist(), 'bias': [3.0, -2.0, 4.0, 0, 0.1, 0]}},
        controller={'sensor': {'require_push_test': True}}))
    control, gate = loop.control, loop.control.push_gate
    for _ in range(150):
        loop.advance()
    tool = control.config.tool.model_copy(
        update={'bias_sensor': tuple(control.tare(TareConfig()).tolist())})
    control.supervisor.reconfigure(control.config.model_copy(update={'tool': tool}))
    model = loop.plant.model
    sensor, tip = (model.frames[model.getFrameId(name)].placement for name in (
        SENSOR_FRAME, loop.plant.config.tool_push_link))
    control.push_test(CONFIG, tuple(sensor.actInv(tip).translation))
    for tick in itertools.count(150):
        if gate.result is not None:
            break
        if tick in pushes:
            loop.plant.push(pushes[tick], LENGTH, tool=True)
        loop.advance()
    loop.close()
    assert verdict in gate.result.message
    assert gate.result.passed is (verdict == 'passed')
