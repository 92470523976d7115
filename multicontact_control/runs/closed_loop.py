"""Plant, control loop and noise estimator in one process, without ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from multicontact_control.arrays import Vector
from multicontact_control.control.controller import ControlOutput
from multicontact_control.errors import (
    ContactGeometryError,
    RunError,
    SingularTaskError,
)
from multicontact_control.force.noise import (
    Innovation,
    make_noise_estimator,
    NoiseEstimator,
)
from multicontact_control.loop import ControlLoop
from multicontact_control.runs.recording import (
    empty_run_data,
    OF_STIFFNESS,
    RunData,
)
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
from multicontact_control.supervision.report import SupervisorStatus
import numpy as np
from sim_bridge.actuator_delay import ActuatorDelay
from sim_bridge.plant import Plant, Sample

HISTORY = 65  # ticks
PROGRESS_TICKS = 100
# Of a recording, what the sample and the answer say.
SAMPLED = ('q', 'qd', 'effort', 'wrench', 'wrench_filtered')
ANSWERED = ('alpha_est', 'alpha_rate_est', 'alpha_des', 'innovation')

Corruption = Callable[[TickInputs], TickInputs]


class ClosedLoop:
    """
    The loop of the graph in one process: what a scenario, a fault or a push is tried on.

    The controller at tick k works with the R of tick k - 1, and its command acts on the plant
    from k + actuator delay on, as in the graph. If `supervised`, contact states, watchdogs and
    limits are around the control law; if `commanded`, `control` obeys commands instead of the
    scenario.
    """

    def __init__(
        self,
        setup: Setup,
        *,
        supervised: bool = True,
        commanded: bool = False,
    ) -> None:
        self.setup = setup
        config = setup.controller
        self.control = ControlLoop(
            config,
            None if commanded else setup.reference(),
            CommandLimits(),
            setup.urdf_dir,
            supervised=supervised,
        )
        self._estimator = make_noise_estimator(setup.noise_estimator)
        self.plant = Plant(setup.plant, rate=config.rate, seed=setup.seed)
        self._delay = ActuatorDelay(
            setup.plant.actuator_delay_ticks, self.plant.initial_torque
        )
        # The sample that is answered next, or has been and not acted on.
        self.tick = 0
        self.sample: Sample = self.plant.reset()
        # The newest R, shape (r,) [N^2], and torque, shape (n,) [N m].
        self.variance: Vector = np.full(
            len(config.columns), config.initial_noise_variance
        )
        self.command: Vector = self.plant.initial_torque
        self.history: deque[TickInputs] = deque(
            maxlen=HISTORY
        )  # of `inputs`, newest last

    @property
    def status(self) -> SupervisorStatus:
        """Return the supervisor's status of the newest answer; RunError if there is none."""
        if self.control.status is None:
            raise RunError(
                'closed loop: expected a supervisor that has answered, got none'
            )
        return self.control.status

    def inputs(self) -> TickInputs:
        """Return what is known at this tick if nothing is wrong with it: sample, and R before."""
        h, k, sample = self.setup.controller.period, self.tick, self.sample
        wrench = getattr(sample, self.setup.controller.wrench_series)
        return TickInputs(
            time=k * h,
            joints=JointInput(k * h, sample.q, sample.qd, effort=sample.effort),
            wrench=WrenchInput(k * h, wrench),
            variance=VarianceInput((k - 1) * h, self.variance) if k else None,
        )

    def answer(self, corrupt: Corruption | None = None) -> ControlOutput:
        """
        Let the control loop answer the sample, and the estimator find the next R.

        `corrupt` changes the readings on their way from the sensors. Raises MulticontactError
        without supervisor, if there is no torque for this posture, and RunError in the safe
        behaviour.
        """
        inputs = self.inputs()
        self.history.append(inputs)
        self.command = self.control.step(inputs if corrupt is None else corrupt(inputs))
        output = self.control.output
        if output is None:
            raise RunError(
                'closed loop: expected a controller at work, got its safe behaviour'
            )
        self.variance = estimate_variance(self._estimator, output)
        return output

    def act(self) -> None:
        """Let the command act on the plant when its time has come, and take the next sample."""
        self._delay.enter_command(self.tick, self.command)
        self.sample = self.plant.step(self._delay.torque_for(self.tick))
        self.tick += 1

    def advance(self, corrupt: Corruption | None = None) -> ControlOutput:
        """Take one tick: `answer`, then `act`."""
        output = self.answer(corrupt)
        self.act()
        return output

    def close(self) -> None:
        """Give the simulator's memory back."""
        self.plant.close()


def estimate_variance(estimator: NoiseEstimator, output: ControlOutput) -> Vector:
    """Return what an estimator makes of an answer: the R of the next tick, shape (r,) [N^2]."""
    answer = output.answer
    return estimator.update(
        output.contacts['alpha_meas'],
        Innovation(
            answer['innovation'], answer['prior_variance'], answer['variance_used']
        )
        if estimator.uses_innovation
        else None,
    )


@dataclass(frozen=True)
class LoopResult:
    """What a run in process leaves."""

    data: RunData
    ended_early: str = ''  # why, if it did
    events: tuple[
        tuple[float, str], ...
    ] = ()  # of the supervisor: time [s] and what changed


def run_in_process(
    setup: Setup,
    on_progress: Callable[[float, Vector], None] | None = None,
    *,
    supervised: bool = False,
    disturb: Callable[[ClosedLoop], None] | None = None,
) -> LoopResult:
    """
    Run a scenario as fast as it goes, up to where the arm can no longer be controlled.

    `on_progress` is called every 100 ticks with the time [s] and the measured forces [N],
    `disturb` with the loop before each tick.
    """
    data = empty_run_data(setup.ticks, setup.controller)
    ended_early, done = '', setup.ticks
    loop = ClosedLoop(setup, supervised=supervised)
    try:
        for k in range(setup.ticks):
            if disturb is not None:
                disturb(loop)
            try:
                output = loop.answer()
            except (
                SingularTaskError,
                ContactGeometryError,
                np.linalg.LinAlgError,
            ) as error:
                ended_early, done = f'tick {k}: {error}', k
                break
            _record(data, loop, output)
            if not np.isfinite(output.torque).all():
                ended_early, done = (
                    f'tick {k}: the commanded torque is not finite',
                    k + 1,
                )
                break
            if k + 1 < setup.ticks:
                loop.act()
            if on_progress is not None and k % PROGRESS_TICKS == 0:
                on_progress(data.time[k], output.contacts['alpha_meas'])
    finally:
        loop.close()
    return LoopResult(
        data.part(0, done), ended_early, tuple(loop.control.events.events)
    )


def _record(data: RunData, loop: ClosedLoop, output: ControlOutput) -> None:
    k = loop.tick
    for name in SAMPLED:
        getattr(data, name)[k] = getattr(loop.sample, name)
    for name in ANSWERED:
        getattr(data, name)[k] = output.answer[name]
    data.torque[k], data.alpha_meas[k] = output.torque, output.contacts['alpha_meas']
    if loop.setup.controller.force.stiffness == 'adaptive':
        for name in OF_STIFFNESS:
            getattr(data, name)[k] = output.contacts[name]
    data.alpha_true[k] = loop.sample.contact_force
    data.noise_variance[k] = loop.variance
    data.position[k] = output.pose.position_world
    data.quaternion[k] = output.pose.quaternion_xyzw
    data.position_des[k] = output.pose_des.position_world
    data.quaternion_des[k] = output.pose_des.quaternion_xyzw
