"""The gymnasium environment: plant and control loop in process, commanded by actions."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.config import validate
from multicontact_control.control.motions import plan_motion, PlannedMotion
from multicontact_control.control.tasks import MotionReading, SteeredTask
from multicontact_control.control.trajectory_checks import check_position
from multicontact_control.errors import CommandError, ConfigError
from multicontact_control.learning.actions import ActionLayout, Wishes
from multicontact_control.learning.config import EnvironmentConfig
from multicontact_control.learning.limiting import ActionLimiter, RAMP_SHARE
from multicontact_control.learning.observations import (
    Observation,
    observation_space,
    observe,
)
from multicontact_control.learning.rewards import EpisodeStep, REWARDS
from multicontact_control.learning.worlds import Worlds
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.compilation import ensure_compiled
from multicontact_control.supervision.causes import INFLATE, NONE
from multicontact_control.supervision.contacts import HOLDING, STATE_NAMES
import numpy as np
from numpy.typing import NDArray
from sim_bridge.picture import Image, take_picture
from sim_bridge.surface import SURFACE

LONGEST_SETTLING = 5.0  # s, in which the contacts are made before an episode begins

Action = NDArray[np.float32]


class MultiContactEnv(gymnasium.Env[Observation, Action]):
    """
    An arm that presses and moves, behind the supervisor, as an environment of gymnasium.

    An action asks, the controller obeys as far as the supervisor lets it. What was not obeyed is
    in the `info` of the step, with its cause: `clipped`, `refused` and `limited` (of the action),
    `left_out` (of the motion), `limits` and `rejected` (of the supervisor), `reaction` and
    `causes`. An episode is terminated when the supervisor takes the arm from the controller,
    and truncated at its end; `ended` says why.

    Parameters
    ----------
    render_mode
        None or ``rgb_array``.
    options
        Those of `EnvironmentConfig`, by name.

    Attributes
    ----------
    config
        What was chosen.
    action_names
        What each number of an action is.
    loop
        Plant and controller of the episode, None before the first.

    Raises
    ------
    ConfigError
        With every option that is not acceptable.

    """

    metadata: dict[str, Any] = {'render_modes': ['rgb_array'], 'render_fps': 50}

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        if render_mode not in (None, *self.metadata['render_modes']):
            raise ConfigError('render_mode', 'rgb_array or none', render_mode)
        self.render_mode = render_mode
        self.config = validate(EnvironmentConfig, options, 'environment')
        self._worlds = Worlds(self.config)
        setup = self._worlds.mean
        controller = setup.controller
        self._ticks = _count_ticks(self.config.rate, controller.rate)
        self._layout = ActionLayout(self.config, controller)
        self.action_names = self._layout.names
        size = len(self.action_names)
        self.action_space = spaces.Box(-1.0, 1.0, (size,), np.float32)
        self._space = observation_space(self.config, controller, size)
        self.observation_space = self._space
        self.metadata = {**self.metadata, 'render_fps': round(self.config.rate)}
        self.loop: ClosedLoop | None = None
        ensure_compiled()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """
        Begin an episode in a world that is drawn; the same seed begins the same one.

        The contacts are pressed first. `info` has what was drawn (`drawn`), by dotted name.
        `options` change nothing.
        """
        super().reset(seed=seed)
        self.close()
        setup, drawn = self._worlds.draw(self.np_random)
        controller = setup.controller
        self._task = SteeredTask(controller.column_names, controller.leading_columns)
        self.loop = loop = ClosedLoop(setup, source=self._task)
        self._forces: deque[Vector] = deque(maxlen=self.config.window)
        self._forces.extend([np.zeros(len(controller.columns))] * self.config.window)
        self._ended = ''
        # It keeps its place in memory as long as the plant is not reset.
        self._surfaces = np.asarray(loop.plant.contacts.surfaces)
        free_reading = self._press_contacts(loop)
        self._plan_episode(loop)
        self._limiter = ActionLimiter(
            self.config,
            controller,
            self._ticks * controller.period,
            loop.control.supervisor.task.reference_pose(),
            free_reading,
        )
        self._action: Vector = np.zeros(len(self.action_names))
        info = {**self._describe(loop), 'drawn': drawn}
        return self._observe(loop), info

    def _press_contacts(self, loop: ClosedLoop) -> Vector:
        """
        Let control begin and press every contact, for some seconds at most.

        Returns what they read before, shape (r,) [N].
        """
        controller = loop.setup.controller
        force = self.config.initial_force
        wanted = STATE_NAMES[HOLDING]
        begun = False
        free_reading = self._forces[-1]
        for _ in range(round(LONGEST_SETTLING * controller.rate)):
            self._advance(loop)
            if not begun and loop.control.supervisor.started:
                begun = True
                free_reading = self._forces[-1]
                if force == 0.0:
                    break
                loop.control.set_forces(dict.fromkeys(controller.contact_names, force))
            if all(state == wanted for state in loop.status.contact_states):
                break
        return free_reading

    def _plan_episode(self, loop: ClosedLoop) -> None:
        """Work out what the scenario asks for at each step: forces and places on its path."""
        setup = loop.setup
        begin = self.config.begin
        duration = self.config.duration
        if duration is None:
            duration = max(setup.scenario.duration - begin, 1.0 / self.config.rate)
        self._steps = max(1, round(duration * self.config.rate))
        times = begin + np.arange(self._steps + 1) / self.config.rate
        self._targets = setup.commanded(times)
        pose = loop.control.supervisor.task.reference_pose()
        self._path = np.tile(pose.position_world, (len(times), 1))
        motion = setup.scenario.reference.motion
        if motion is not None:
            planned = plan_motion(motion, setup.controller.limits)
            normals = {
                name: np.array(setup.controller.contacts[name].normal_world)
                for name in setup.controller.contact_names
            }
            planned.start(pose.position_world, normals)
            moved = _displacements(planned, times, motion.start_time)
            self._path += moved - moved[0]
        self._step = 0

    def step(
        self, action: Action
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """
        Obey an action for a step, as far as that is safe; return what gymnasium says.

        Numbers beyond [-1, 1] are clipped, and an action with others than finite numbers is
        refused: the one before it stays. Raises ShapeError for another count of numbers,
        ResetNeeded after the end of an episode.
        """
        loop = self.loop
        if loop is None or self._ended:
            raise ResetNeeded(f'the episode has ended ({self._ended}): call reset()')
        before = self._action
        clipped, refused = self._take_action(action)
        wishes = self._layout.read_wishes(self._action)
        left_out = self._command(loop, wishes, refused)
        forces = np.zeros((self._ticks, len(self._targets[0])))
        surfaces = np.zeros((self._ticks, len(self._surfaces)), dtype=SURFACE)
        limits: set[str] = set()
        rejected: set[str] = set()
        ticks = 0
        for tick in range(self._ticks):
            self._advance(loop)
            forces[tick] = loop.sample.contact_force
            surfaces[tick] = self._surfaces
            status = loop.status
            limits.update(status.limits)
            rejected.update(status.rejected)
            ticks = tick + 1
            if status.reaction not in (NONE, INFLATE):
                self._ended = f'{status.reaction}: {", ".join(status.causes)}'
                break
        self._step += 1
        terminated = bool(self._ended)
        truncated = not terminated and self._step >= self._steps
        if truncated:
            self._ended = 'duration'
        done = EpisodeStep(
            forces[:ticks],
            self._targets[self._step],
            _sideways_loads(surfaces[:ticks]),
            self._path_error(loop),
            self._action,
            before,
        )
        rewards = {name: REWARDS[name](done) for name in self.config.rewards}
        reward = sum(self.config.rewards[name] * rewards[name] for name in rewards)
        info = {
            **self._describe(loop),
            'clipped': clipped,
            'refused': '; '.join(refused),
            'left_out': left_out,
            'limited': tuple(sorted(self._limiter.limited)),
            'limits': tuple(sorted(limits)),
            'rejected': tuple(sorted(rejected)),
            'rewards': rewards,
            'force_true': forces[:ticks].mean(axis=0),
        }
        return self._observe(loop), float(reward), terminated, truncated, info

    def _take_action(self, action: Action) -> tuple[bool, list[str]]:
        """Take a new action; return whether it was clipped, and why it was refused."""
        numbers = np.asarray(action, dtype=float)
        require_shape('action', numbers, self._action.shape)
        if not np.isfinite(numbers).all():
            return False, [f'action: expected finite numbers, got {numbers.tolist()}']
        self._action = np.clip(numbers, -1.0, 1.0)
        return bool((self._action != numbers).any()), []

    def _command(self, loop: ClosedLoop, wishes: Wishes, refused: list[str]) -> str:
        """Command what is wished; list what is refused, return which motion is not obeyed."""
        control = loop.control
        forces = wishes.forces
        if forces is None:
            names = loop.setup.controller.column_names
            forces = dict(zip(names, self._targets[self._step + 1].tolist()))
        twist = wishes.twist_world
        if twist is None:
            twist = np.zeros(6)
            way = self._path[self._step + 1] - self._path[self._step]
            twist[:3] = way * self.config.rate
        left_out = ''
        limiter = self._limiter
        limiter.begin_step(self._output, loop.status.contact_states)
        before = self._task.forces
        with _listing_refusal(refused):
            control.set_forces(limiter.limit_forces(forces, before), wishes.centres)
        with _listing_refusal(refused):
            left_out = control.set_motion(self._next_motion(loop, twist, refused))
        if wishes.natural_frequency is not None:
            frequency = limiter.limit_frequency(wishes.natural_frequency)
            if frequency != control.config.motion.natural_frequency:
                motion = control.config.motion.model_copy(
                    update={'natural_frequency': frequency}
                )
                config = control.config.model_copy(update={'motion': motion})
                # Where the posture allows no change it is refused, too.
                with _listing_refusal(refused):
                    control.reconfigure(config)
        return left_out

    def _next_motion(
        self, loop: ClosedLoop, wanted: Vector, refused: list[str]
    ) -> MotionReading:
        """
        Return the motion at the next tick, which goes over to a wanted twist within the step.

        It stops, with the cause in `refused`, before it would leave the workspace.
        """
        limits = loop.setup.controller.limits
        period = loop.setup.controller.period
        length = self._ticks * period
        reference = loop.control.supervisor.task.reference_pose()
        pose = self._limiter.leave_surfaces(reference)
        slowing = RAMP_SHARE * limits.operational_acceleration
        speed = float(np.linalg.norm(wanted[:3]))
        way = (length + 0.5 * speed / slowing) * wanted[:3]
        try:
            check_position(pose.position_world + way, limits)
        except CommandError as error:
            refused.append(str(error))
            wanted = np.zeros(6)
        twist, acceleration = self._limiter.limit_twist(wanted, pose)
        twist = twist - (length - period) * acceleration
        pose = pose.moved_by(period * twist)
        return MotionReading(
            pose.position_world, pose.quaternion_xyzw, twist, acceleration
        )

    def _advance(self, loop: ClosedLoop) -> None:
        """Take a tick, and keep its measured forces."""
        self._output = loop.advance()
        self._forces.append(self._output.contacts['alpha_meas'].copy())

    def _path_error(self, loop: ClosedLoop) -> Vector:
        """Return the way to the scenario's path, without what contacts place, (3,) [m]."""
        reference = loop.control.supervisor.task.reference_pose()
        output = self._output
        deviation = output.pose.position_world - output.pose_des.position_world
        return self._path[self._step] - reference.position_world - deviation

    def _observe(self, loop: ClosedLoop) -> Observation:
        return observe(
            self._space,
            self._output,
            loop.status.contact_states,
            self._targets[self._step],
            self._path_error(loop),
            np.array(self._forces),
            self._action,
        )

    def _describe(self, loop: ClosedLoop) -> dict[str, Any]:
        """Return what the supervisor says of the newest tick."""
        status = loop.status
        return {
            'time': self._step / self.config.rate,
            'reaction': status.reaction,
            'causes': status.causes,
            'contact_states': status.contact_states,
            'ended': self._ended,
        }

    def render(self) -> Image | None:
        """Return a picture of the arm and its surfaces, (360, 480, 3), by the plant's engine."""
        if self.render_mode is None or self.loop is None:
            return None
        return take_picture(self.loop.plant)

    def close(self) -> None:
        """Give the simulator's memory back."""
        if self.loop is not None:
            self.loop.close()
            self.loop = None


@contextmanager
def _listing_refusal(refused: list[str]) -> Iterator[None]:
    """Add to a list why a command is refused, which then has no effect."""
    try:
        yield
    except (CommandError, ConfigError) as error:
        refused.append(str(error))


def _count_ticks(rate: float, control_rate: float) -> int:
    """Return the control periods in a step; ConfigError if they are no whole number."""
    ticks = round(control_rate / rate)
    if ticks < 1 or abs(ticks * rate - control_rate) > 1e-6 * control_rate:
        raise ConfigError(
            'rate', f'a whole fraction of the control rate {control_rate:g} Hz', rate
        )
    return ticks


def _displacements(motion: PlannedMotion, times: Vector, start_time: float) -> Matrix:
    """Return the displacements of a motion at rising times, shape (m, 3) [m]."""
    moved = np.zeros((len(times), 3))
    for row, time in zip(moved, times.tolist()):
        if time > start_time:
            row[:] = motion.displace(time)[0]
    return moved


def _sideways_loads(surfaces: NDArray[np.void]) -> Vector:
    """Return the sums of the friction forces on surfaces, records of shape (n, no) [N]."""
    pressed = surfaces['alpha'][..., np.newaxis] * surfaces['facing']
    friction = np.linalg.norm(surfaces['force'] - pressed, axis=-1)
    loads: Vector = friction.sum(axis=-1)
    return loads
