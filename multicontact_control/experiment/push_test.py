"""
The push test as a user meets it: on the simulated arm by a scripted hand, or on a running robot.

The simulated sensor may be wrong. Tare and test are those of the control loop, which holds the
arm meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from multicontact_control.arrays import Matrix
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.calibration import sensor_setup
from multicontact_control.experiment.scenario import Setup
from multicontact_control.sensor.push_test import PushTestConfig, PushTestResult
from multicontact_control.sensor.tool import TareConfig
import numpy as np
from scipy.spatial.transform import Rotation

WRONG_SCALE = 0.5
TARE_TIME, FIRST_PUSH, GAP, MARGIN = 0.3, 1.0, 0.8, 0.2  # s
PASSED, FAILED = 'push test passed', 'push test failed'

Tell = Callable[[str], None]


def fault_mounting(fault: str, seed: int) -> Matrix:
    """
    Return what a fault makes of true forces and torques in sensor axes, shape (3, 3).

    The seed chooses a quarter turn: about x, y, z for 0, 1, 2, the other way for 3, 4, 5. Raises
    ConfigError if there is no such fault.
    """
    turn = (1.0 if seed // 3 % 2 == 0 else -1.0) * np.pi / 2.0
    made = {
        'none': np.eye(3), 'sign': -np.eye(3),
        'rotate': np.round(Rotation.from_rotvec(turn * np.eye(3)[seed % 3]).as_matrix()),
        'scale': WRONG_SCALE * np.eye(3)}
    if fault not in made:
        raise ConfigError('fault', f'one of {", ".join(made)}', f"'{fault}'")
    return made[fault]


def push_setup(
    plant: str, seed: int, config: PushTestConfig, mounting: Matrix, robot: str = '',
) -> Setup:
    """Resolve a plant whose sensor is mounted like that and which is pushed as the test asks."""
    length = config.settle_time + config.hold_time + MARGIN
    count = len(config.directions)
    setup = sensor_setup(
        plant, seed, robot, sensor={'mounting': mounting.ravel().tolist()},
        tool_push_start=[FIRST_PUSH + i * (length + GAP) for i in range(count)],
        tool_push_duration=[length] * count,
        tool_push_force_world=(config.force * config.directions_world).ravel().tolist())
    sensor = setup.controller.sensor.model_copy(update={'require_push_test': True})
    return replace(setup, controller=setup.controller.model_copy(update={'sensor': sensor}))


def push_simulated(
    setup: Setup, config: PushTestConfig, tell: Tell = lambda text: None,
) -> PushTestResult:
    """
    Tare, then push and judge, for a setup of `push_setup`.

    The tare hides a wrong sign at rest: only a push shows it. `tell` is called with each new
    instruction to the user. Raises RunError if the test does not come to its end,
    CalibrationError if the arm does not keep still enough for a tare.
    """
    # Only now: the simulator is not loaded for the sake of an error.
    from multicontact_control.experiment.closed_loop import ClosedLoop
    from multicontact_control.experiment.compilation import ensure_compiled

    ensure_compiled()
    rate = setup.controller.rate
    loop = ClosedLoop(setup)
    control, gate = loop.control, loop.control.push_gate
    try:
        for _ in range(round(TARE_TIME * rate)):
            loop.advance()
        tool = control.config.tool.model_copy(
            update={'bias_sensor': tuple(control.tare(TareConfig()).tolist())})
        control.supervisor.reconfigure(control.config.model_copy(update={'tool': tool}))
        instruction = control.push_test(config, loop.plant.tool_push_point)
        tell(instruction)
        for _ in range(round(3.0 * config.timeout * rate)):
            loop.advance()
            if gate.instruction != instruction:
                tell(instruction := gate.instruction)
            if gate.result is not None:
                return gate.result
    finally:
        loop.close()
    raise RunError(f'push test: expected an end, found it waiting: {gate.instruction}')


def push_running(
    tell: Tell, *, namespace: str = '', domain_id: int | None = None, timeout: float = 10.0,
) -> bool:
    """
    Lead the user through the push test of a running controller; return whether it was passed.

    `tell` is called with each instruction, and with the verdict; `timeout` is the longest wait for
    an answer or a command of the controller [s]. Raises RunError if none comes, or the controller
    is not active.
    """
    from multicontact_control.nodes import topics
    from multicontact_control.nodes.link import ControllerLink
    from std_srvs.srv import Trigger

    with ControllerLink((topics.EFFORT_COMMAND,), namespace=namespace, domain_id=domain_id,
                        timeout=timeout) as link:
        if (state := link.state(topics.CONTROLLER)) != 'active':
            raise RunError(f'{topics.CONTROLLER}: expected an active controller, found it {state}')
        instruction = link.ask('push_test', Trigger, Trigger.Request())
        tell(instruction)
        link.look()  # of before the test
        while not instruction.startswith((PASSED, FAILED)):
            link.fresh(topics.EFFORT_COMMAND)
            for status in link.look():
                if status.push_test not in ('', instruction):
                    tell(instruction := status.push_test)
        return instruction.startswith(PASSED)
