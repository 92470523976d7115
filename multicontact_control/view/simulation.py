"""
The simulation that a page starts: the closed loop in a process of its own, in real time.

It never waits for the page: a snapshot that is not taken is dropped. Commands are read between
ticks, and answered in words.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
import contextlib
from functools import partial
import gc
import math
import os
import pickle
import signal
import socket
import time
from typing import Any

from multicontact_control.config import (
    ControllerConfig,
    merge,
    NoiseEstimatorConfig,
    validate,
    Vector3,
)
from multicontact_control.errors import CommandError, MulticontactError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import Setup
from multicontact_control.force.noise import ESTIMATORS, make_noise_estimator
from multicontact_control.process import settle_process
from multicontact_control.sensor.push_test import PushTestConfig
from multicontact_control.sensor.tool import TareConfig
from multicontact_control.view import source
from multicontact_control.view.motion import Motion
from multicontact_control.view.source import (
    CurveLayout,
    PLAYING,
    POINTS,
    RATE,
    Snapshot,
    SurfaceState,
    Timing,
)
import numpy as np

NANOSECONDS = 1_000_000_000
LONGEST_LAG = 0.1  # s, that is made up for; beyond it time is lost
TIMED = 1000  # ticks
PACE_TIME = 2.0  # s, over which the pace is told
PUSH_TIME = 0.5  # s
HAND_MARGIN = 0.2  # s, that a push of the push test lasts longer than is measured
LARGEST_PUSH = 20.0  # N
STIFFNESS, FRICTION = (200.0, 80_000.0), (0.01, 1.0)  # N/m, that a surface may be given
MESSAGE = 1 << 20  # bytes, at most


class Simulation:
    """
    The closed loop with what is commanded to it, tick by tick.

    Parameters
    ----------
    setup
        Plant, controller and estimator; of the scenario, only what it lays over them.

    Attributes
    ----------
    loop
        The closed loop.

    """

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        config = setup.controller
        self._layout = CurveLayout(len(config.columns), len(config.robot.joint_names))
        self._leaders = list(config.leaders)
        self.every = max(1, round(config.rate / RATE))  # ticks in a snapshot
        self._tick_us: deque[float] = deque(maxlen=TIMED)
        plant = setup.plant
        self._parts: dict[str, list[int]] = {}  # of each contact, and each obstacle
        for index, name in enumerate(plant.met):
            whose = plant.contacts[name] if name in plant.touched else name
            self._parts.setdefault(whose, []).append(index)
        self._surfaces = self._given_surfaces()
        self._push_config = PushTestConfig()
        self._commands: Mapping[str, Callable[..., str]] = {
            source.FORCES: self._forces, source.STOP: lambda: self._motion.stop(),
            source.GO_TO: partial(self._move, Motion.go_to),
            source.JOG: partial(self._move, Motion.jog),
            source.PATTERN: partial(self._move, Motion.start_pattern), source.HOLD: self._hold,
            source.RETRY: lambda: self.loop.control.retry(), source.TARE: self._tare,
            source.PUSH_TEST: self._push_test, source.HAND: self._hand,
            source.ESTIMATOR: self._use_estimator, source.GAINS: self._gains,
            source.SURFACE: self._surface, source.PUSH: self._push, source.RESET: self._reset}
        for name in ESTIMATORS:  # no tick is to wait for what one of them has to load
            make_noise_estimator(setup.noise_estimator.model_copy(update={'estimator': name}))
        self._start()

    def _given_surfaces(self) -> dict[str, SurfaceState]:
        plant = self._setup.plant
        first = {name: plant.surfaces[plant.met[parts[0]]] for name, parts in self._parts.items()}
        return {name: SurfaceState(each.stiffness, each.friction) for name, each in first.items()}

    def _places_now(self) -> dict[str, Vector3]:
        """Return where the surfaces are now."""
        places = self.loop.plant.contacts.places_world.tolist()
        return {name: tuple(places[parts[0]]) for name, parts in self._parts.items()}

    def _start(self) -> None:
        self.loop = ClosedLoop(self._setup, commanded=True)
        self._estimator = self._setup.noise_estimator
        self._motion = Motion(self._setup.controller.limits, self._setup.controller.period)
        self._told = 0
        self._said: list[tuple[float, str]] = []
        self._points: list[Any] = []
        self._counted = 0
        self._clear_point()

    def close(self) -> None:
        """Give the simulator's memory back."""
        self.loop.close()

    @property
    def time(self) -> float:
        """Time of the simulation [s]."""
        return self.loop.tick * self._setup.controller.period

    def advance(self) -> None:
        """Take one tick."""
        control = self.loop.control
        if control.output is None or control.commanded_pose is None:
            self._answer()
            pose = control.commanded_pose
            if pose is not None:
                self._motion.start(pose.position_world, pose.quaternion_xyzw)
            return
        wanted = self._motion.advance()
        if wanted is not None:
            try:
                control.set_motion(wanted)
            except CommandError as error:
                with contextlib.suppress(CommandError):
                    control.set_motion(self._motion.halt())
                self._say(f'motion stopped: {error}')
            pose = control.commanded_pose
            if pose is not None:
                self._motion.accepted(pose.position_world)
        self._answer()

    def _answer(self) -> None:
        loop = self.loop
        before = time.perf_counter_ns()
        output = loop.answer()
        self._tick_us.append((time.perf_counter_ns() - before) * 1e-3)
        loop.act()
        contacts = output.contacts
        self._sum[0] += contacts['alpha_meas']
        self._sum[1] += contacts['answer']['alpha_est']
        self._sum[2] += contacts['answer']['innovation'] ** 2
        limit = self._setup.controller.torque_limit
        if limit:
            np.maximum(self._use, np.abs(output.torque) / limit, out=self._use)
        self._counted += 1
        if self._counted >= self.every // POINTS:
            n = self._counted
            self._points.append(np.concatenate([
                [self.time], self._sum[0] / n, self._sum[1] / n, contacts['answer']['alpha_des'],
                loop.variance, np.sqrt(self._sum[2] / n), self._use]))
            self._clear_point()

    def _clear_point(self) -> None:
        self._sum = np.zeros((3, self._layout.columns))
        self._use = np.zeros(self._layout.joints)
        self._counted = 0

    def _say(self, what: str) -> None:
        self._said.append((self.time, what))

    def snapshot(self, misses: int, pace: float) -> Snapshot | None:
        """Return what there is to show since the last one, None before the first answer."""
        control = self.loop.control
        output, status = control.output, control.status
        if output is None or status is None:
            return None
        config = control.config
        events = control.events.events[self._told:]
        self._told += len(events)
        said, self._said = self._said, []
        points, self._points = self._points, []
        slow = np.percentile(self._tick_us, (50.0, 99.0)) if self._tick_us else (math.nan,) * 2
        pose, gate = output.pose, control.push_gate
        return Snapshot(
            time=self.time, q=self.loop.sample.q.copy(), position=pose.position_world.copy(),
            quaternion=pose.quaternion_xyzw, position_des=output.pose_des.position_world.copy(),
            measured=output.alpha_meas.copy(), estimated=output.alpha_est.copy(),
            desired=output.alpha_des.copy(),
            normals_world=output.contacts['normal'][self._leaders].copy(),
            states=status.contact_states, reaction=status.reaction,
            reasons=status.causes + status.limits,
            points=np.array(points).reshape(-1, self._layout.width),
            commanded=control.commanded_forces, goal=self._motion.goal,
            events=tuple(sorted([*events, *said])),
            timing=Timing(float(slow[0]), float(slow[1]), misses, pace), held=control.held,
            moving=self._motion.what, push_test=gate.instruction,
            asked_push=tuple(self._asked_push()),
            gains=(config.motion.natural_frequency, config.force.time_constant,
                   config.force.damping_rate),
            estimator=self._estimator.estimator, surfaces=dict(self._surfaces),
            places_world=self._places_now(), playing=True)

    def obey(self, name: str, values: Mapping[str, Any]) -> str:
        """
        Obey a command between two ticks.

        Raises
        ------
        MulticontactError
            If it is refused.

        """
        source.refuse_if_unknown(name, REFUSALS)
        try:
            return self._commands[name](**values)
        except (TypeError, ValueError) as error:  # of values that no page sends
            raise CommandError(name, 'values that it takes', error) from None

    def _forces(self, **forces: float) -> str:
        self.loop.control.set_forces({name: float(force) for name, force in forces.items()})
        return ', '.join(f'{name} {force:g} N' for name, force in forces.items())

    def _move(self, motion: Callable[..., str], /, **values: Any) -> str:
        """Begin a motion; `CommandError` with the loop's own words if it is not possible now."""
        if self.loop.control.commanded_pose is None:
            raise CommandError('controller', 'active, with samples coming', 'not so')
        if not self._motion.what:
            self.loop.control.set_motion(self._motion.halt())
        return motion(self._motion, **values)

    def _hold(self, on: bool) -> str:
        if on:
            with contextlib.suppress(CommandError):  # held already, then that is said below
                self.loop.control.set_motion(self._motion.halt())
        self.loop.control.hold(bool(on))
        return 'held' if on else 'released'

    def _tare(self) -> str:
        control = self.loop.control
        bias = control.tare(TareConfig()).tolist()
        control.supervisor.reconfigure(control.config.model_copy(update={
            'tool': control.config.tool.model_copy(update={'bias_sensor': tuple(bias)})}))
        return 'bias ' + ', '.join(f'{x:.3g}' for x in bias[:3]) + ' N'

    def _push_test(self) -> str:
        with contextlib.suppress(CommandError):
            self.loop.control.set_motion(self._motion.halt())
        return self.loop.control.push_test(self._push_config, self.loop.plant.tool_push_point)

    def _asked_push(self) -> Any:
        """Return the push that the test waits for [N], nothing if it waits for none."""
        said = self.loop.control.push_gate.instruction
        if not (self.loop.control.push_gate.running and said.startswith('push')):
            return ()
        for name, direction in zip(
                self._push_config.directions, self._push_config.directions_world):
            if name in said:
                return self._push_config.force * direction
        return ()

    def _hand(self) -> str:
        force = self._asked_push()
        if not len(force):
            raise CommandError('hand', 'a push test that waits for a push',
                               f"'{self.loop.control.push_gate.instruction or 'none'}'")
        test = self._push_config
        length = test.settle_time + test.hold_time + HAND_MARGIN
        self.loop.plant.push(np.array(force), length, tool=True)
        return f'pushing the tool with {_newtons(force)}'

    def _use_estimator(self, name: str) -> str:
        self._estimator = validate(NoiseEstimatorConfig, {
            **self._estimator.model_dump(), 'estimator': name})
        self.loop.estimate_by(self._estimator)
        self._say(f'R by {name}')
        return f'R by {name}'

    def _gains(
        self, natural_frequency: float, time_constant: float, damping_rate: float,
    ) -> str:
        control = self.loop.control
        control.supervisor.reconfigure(validate(ControllerConfig, merge(
            control.config.model_dump(), {
                'motion': {'natural_frequency': natural_frequency},
                'force': {'time_constant': time_constant, 'damping_rate': damping_rate}})))
        told = (f'natural frequency {natural_frequency:g} rad/s, time constant '
                f'{1e3 * time_constant:g} ms, K_2 {damping_rate:g} 1/s')
        self._say(told)
        return told

    def _surface(self, name: str, stiffness: float, friction: float) -> str:
        before = self._surfaces.get(name)
        if before is None:
            raise CommandError('surface', f'one of {", ".join(self._surfaces)}', f"'{name}'")
        for what, value, (lower, upper), unit in (
                ('stiffness', stiffness, STIFFNESS, ' N/m'), ('friction', friction, FRICTION, '')):
            if not lower <= value <= upper:
                raise CommandError(what, f'{lower:g} to {upper:g}{unit}', f'{value:g}{unit}')
        contacts = self.loop.plant.contacts
        for index in self._parts[name]:
            if stiffness != before.stiffness:
                contacts.scale_stiffness(index, stiffness / before.stiffness)
            if friction != before.friction:
                contacts.set_friction(index, friction)
        self._surfaces[name] = before._replace(stiffness=stiffness, friction=friction)
        told = f'{name}: {stiffness:g} N/m, friction {friction:g}'
        self._say(told)
        return told

    def _push(self, force: list[float]) -> str:
        vector = np.array(force, dtype=float)
        size = float(np.linalg.norm(vector)) if vector.shape == (3,) else math.nan
        if not 0.0 < size <= LARGEST_PUSH:
            raise CommandError('push', f'above 0 to {LARGEST_PUSH:g} N', f'{size:g} N')
        self.loop.plant.push(vector, PUSH_TIME)
        self._say(f'pushed by {_newtons(vector)}')
        return f'pushing with {_newtons(vector)}'

    def _reset(self) -> str:
        self.loop.close()
        self._surfaces = self._given_surfaces()
        self._tick_us.clear()
        self._start()
        self._say('started anew')
        return 'started anew'


REFUSALS = dict.fromkeys(PLAYING, 'a recording')


def _newtons(vector: Any) -> str:
    named = [f'{x:+g} N along {axis}' for axis, x in zip('xyz', vector) if x]
    return ', '.join(named)


def run_simulation(setup: Setup, connection: socket.socket, parent: int) -> None:
    """
    Simulate in real time until the other end of a connection is closed.

    Parameters
    ----------
    setup
        What to simulate.
    connection
        Datagrams with pickled pairs: commands come in as (number, (name, values)), answers go out
        as (number, (whether obeyed, text)), snapshots as (-1, snapshot), and the last words as
        (-2, text).
    parent
        Number of the process that is to be outlived by none.

    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal: it is the page that ends this
    connection.setblocking(False)
    try:
        simulation = Simulation(setup)
        try:
            _keep_pace(simulation, connection, setup.controller.period, parent)
        finally:
            simulation.close()
    except Exception as error:  # whatever it is, the page is to say it
        connection.setblocking(True)
        connection.settimeout(1.0)
        with contextlib.suppress(OSError):
            connection.send(pickle.dumps((-2, f'{type(error).__name__}: {error}')))
        raise


def _keep_pace(
    simulation: Simulation, connection: socket.socket, period: float, parent: int,
) -> None:
    settle_process()
    h = round(period * NANOSECONDS)
    lag = round(LONGEST_LAG * NANOSECONDS)
    misses = tick = 0
    answers: deque[bytes] = deque()
    paces: deque[tuple[int, int]] = deque(maxlen=max(2, round(PACE_TIME * RATE)))
    due = time.monotonic_ns()
    while True:
        now = time.monotonic_ns()
        if due > now:
            time.sleep((due - now) * 1e-9)
        elif now - due > lag:
            due = now
        simulation.advance()
        tick += 1
        due += h
        misses += time.monotonic_ns() > due
        message = _receive(connection)
        if message is not None:
            if not message:
                return  # the page has gone
            number, (name, values) = pickle.loads(message)
            answers.append(pickle.dumps((number, _answer(simulation, name, values))))
            if name == source.RESET:
                gc.collect()
                due, misses = time.monotonic_ns(), 0
                paces.clear()
        if answers and _send(connection, answers[0]):
            answers.popleft()
        if tick % simulation.every == 0:
            if os.getppid() != parent:
                return
            now = time.monotonic_ns()
            pace = 1.0
            if paces and now > paces[0][1]:
                pace = (tick - paces[0][0]) * h / (now - paces[0][1])
            paces.append((tick, now))
            _send(connection, pickle.dumps((-1, simulation.snapshot(misses, pace))))


def _answer(simulation: Simulation, name: str, values: Mapping[str, Any]) -> tuple[bool, str]:
    try:
        return True, simulation.obey(name, values)
    except MulticontactError as error:
        return False, str(error)


def _receive(connection: socket.socket) -> bytes | None:
    """Return a message, None if there is none, nothing in it if there never will be."""
    try:
        return connection.recv(MESSAGE)
    except BlockingIOError:
        return None
    except ConnectionError:
        return b''


def _send(connection: socket.socket, message: bytes) -> bool:
    """Return whether a message could be sent without waiting."""
    try:
        connection.send(message)
    except BlockingIOError:
        return False
    except ConnectionError:
        return True  # the next look finds out
    return True
