"""Plant, control loop and noise estimator in one process, without ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from multicontact_control.arrays import Vector
from multicontact_control.control.controller import ControlOutput
from multicontact_control.control.tasks import TaskSource
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
from multicontact_control.runs.recording import empty_run_data, RunData
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
# The series of a recording that are fields of the sample, the answer and the contacts.
OF_SAMPLE = ('q', 'qd', 'effort', 'wrench', 'wrench_filtered')
OF_ANSWER = ('alpha_est', 'alpha_rate_est', 'alpha_des', 'innovation')
OF_STIFFNESS = ('stiffness', 'stiffness_est', 'stiffness_std', 'margin')

Corruption = Callable[[TickInputs], TickInputs]


class ClosedLoop:
    """
    The loop of the graph in one process: what a scenario, a fault or a push is tried on.

    The controller at tick k works with the R of tick k - 1, and its command acts on the plant
    from k + actuator delay on, as in the graph. If `supervised`, contact states, watchdogs and
    limits are around the control law; if `commanded`, `control` obeys commands instead of the
    scenario, and with a `source` it does what that wants.
    """

    def __init__(
        self,
        setup: Setup,
        *,
        supervised: bool = True,
        commanded: bool = False,
        source: TaskSource | None = None,
    ) -> None:
        self.setup = setup
        config = setup.controller
        if source is None and not commanded:
            source = setup.reference()
        self.control = ControlLoop(
            config,
            source,
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
        # What `inputs` has returned, newest last.
        self.history: deque[TickInputs] = deque(maxlen=HISTORY)

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
        config = self.setup.controller
        sample = self.sample
        time = self.tick * config.period
        variance = None
        if self.tick > 0:
            variance = VarianceInput((self.tick - 1) * config.period, self.variance)
        return TickInputs(
            time,
            JointInput(time, sample.q, sample.qd, effort=sample.effort),
            WrenchInput(time, getattr(sample, config.wrench_series)),
            variance,
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
        if corrupt is not None:
            inputs = corrupt(inputs)
        self.command = self.control.step(inputs)
        output = self.control.output
        if output is None:
            raise RunError(
                'closed loop: expected a controller at work, got its safe behaviour'
            )
        self.variance = estimate_variance(self._estimator, output)
        return output

    def act(self) -> None:
        """
        Let the command act on the plant when its time has come, and take the next sample.

        The command of tick k reaches the plant with k + `plant.actuator_delay_ticks`.
        """
        self._delay.enter_command(self.tick, self.command)
        self.sample = self.plant.step(self._delay.torque_for(self.tick))
        self.tick += 1

    def advance(self, corrupt: Corruption | None = None) -> ControlOutput:
        """Take one tick: `answer`, then `act`; return the answer, and raise what it raises."""
        output = self.answer(corrupt)
        self.act()
        return output

    def close(self) -> None:
        """Give the simulator's memory back; the loop cannot be stepped any more."""
        self.plant.close()


def estimate_variance(estimator: NoiseEstimator, output: ControlOutput) -> Vector:
    """
    Return what an estimator makes of an answer: the R of the next tick, shape (r,) [N^2].

    Estimators of innovations get what the observers did not expect (P04 eq. 42), all others the
    measured forces alone. The last R is given again where the wrench is not of this sample.
    """
    innovation = None
    if estimator.uses_innovation:
        answer = output.answer
        innovation = Innovation(
            answer['innovation'], answer['prior_variance'], answer['variance_used']
        )
    measured = bool(output.controls['measured'][0])
    return estimator.update(
        output.contacts['alpha_meas'], innovation, measured=measured
    )


@dataclass(frozen=True)
class LoopResult:
    """
    What a run in process leaves: its series, up to where it ended, and why it ended there.

    A run ends early where the arm has no torque for its posture, or an infinite one.
    """

    data: RunData
    ended_early: str  # why; empty for a run of its whole length
    events: Sequence[tuple[float, str]]  # of the supervisor: time [s] and what changed


def run_in_process(
    setup: Setup,
    on_progress: Callable[[float, Vector], None] | None = None,
    *,
    supervised: bool = False,
    disturb: Callable[[ClosedLoop], None] | None = None,
) -> LoopResult:
    """
    Run a scenario as fast as it goes, up to where the arm can no longer be controlled.

    Parameters
    ----------
    setup
        The scenario with controller, estimator and plant, as `resolve` returns it.
    on_progress
        Called every 100 ticks with the time [s] and the measured forces, shape (r,) [N].
    supervised
        Whether contact states, watchdogs and limits are around the control law.
    disturb
        Called with the loop before each tick, to push the arm or to change what it does.

    """
    data = empty_run_data(setup.ticks, setup.controller)
    ended_early = ''
    recorded = 0
    loop = ClosedLoop(setup, supervised=supervised)
    try:
        for tick in range(setup.ticks):
            if disturb is not None:
                disturb(loop)
            try:
                output = loop.answer()
            except (
                SingularTaskError,
                ContactGeometryError,
                np.linalg.LinAlgError,
            ) as error:
                ended_early = f'tick {tick}: {error}'
                break
            _record_tick(data, loop, output)
            recorded = tick + 1
            if not np.isfinite(output.torque).all():
                ended_early = f'tick {tick}: the commanded torque is not finite'
                break
            if recorded < setup.ticks:
                loop.act()
            if on_progress is not None and tick % PROGRESS_TICKS == 0:
                on_progress(data.time[tick], output.contacts['alpha_meas'])
    finally:
        loop.close()
    return LoopResult(data.part(0, recorded), ended_early, loop.control.events.events)


def _record_tick(data: RunData, loop: ClosedLoop, output: ControlOutput) -> None:
    """Write sample and answer of the loop's tick into the row of that tick."""
    row = loop.tick
    for name in OF_SAMPLE:
        getattr(data, name)[row] = getattr(loop.sample, name)
    for name in OF_ANSWER:
        getattr(data, name)[row] = output.answer[name]
    if loop.setup.controller.force.stiffness == 'adaptive':
        for name in OF_STIFFNESS:
            getattr(data, name)[row] = output.contacts[name]
    data.torque[row] = output.torque
    data.alpha_meas[row] = output.contacts['alpha_meas']
    data.alpha_true[row] = loop.sample.contact_force
    data.noise_variance[row] = loop.variance
    data.position[row] = output.pose.position_world
    data.quaternion[row] = output.pose.quaternion_xyzw
    data.position_des[row] = output.pose_des.position_world
    data.quaternion_des[row] = output.pose_des.quaternion_xyzw
