"""
A long time of work in process: random commands, random faults, and what must never happen.

An episode is one thing that an operator or fate does. After it, everything has to be as it was
commanded again; then the next one begins.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
import contextlib
from dataclasses import dataclass, field
import math
from pathlib import Path
import resource

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.errors import CommandError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.fault import Fault, PlantEdit, PROCESS
from multicontact_control.experiment.faults.in_process import advance_with, Occurrence
from multicontact_control.experiment.faults.judge import MET_FORCE
from multicontact_control.experiment.faults.vocabulary import faults_of
from multicontact_control.experiment.metrics import torque_limit
from multicontact_control.experiment.oscillation import oscillations, STRETCH, WINDOW
from multicontact_control.experiment.scenario import Setup
from multicontact_control.quintic import quintic
from multicontact_control.sampling import MotionReading
from multicontact_control.supervision.contacts import ContactState
import numpy as np

LARGEST_FORCE = 25.0  # N, that is commanded
RELEASED_SHARE = 0.1  # of the commands, that let a contact go
REACH = 0.1  # m, of the motion to either side of the start
FASTEST = 0.2  # m/s
PAUSE = (0.2, 3.0)  # s, between episodes; from 2 s on one alone shows an oscillation
HOLD_TIME = (0.5, 3.0)  # s
EPISODES = ('forces', 'motion', 'hold', 'fault', 'two faults')
CHANCES = (0.35, 0.3, 0.05, 0.24, 0.06)
SETTLE_TIME = 15.0  # s, in which all must be as commanded again, with the operator's help 3 times
OFF = 0.15  # of the command, and 1 N: mean force error over 0.5 s that is as commanded
FORCE_MARGIN, FORCE_TIME = 1.25, 0.1  # times the ceiling; s beyond that
TOLERANCE = 1e-9  # of a torque's limit and rate
MOST_REPORTED = 50  # problems that are described
PROBLEMS = ('unsafe', 'alternating', 'oscillating', 'stuck')


@dataclass
class Minute:
    """
    One minute of a soak.

    Attributes
    ----------
    memory_mb
        Resident memory of the process.
    error_n
        Mean error of the true forces while nothing happens, NaN without such a time.
    error_rms_n
        Its rms, with all that averages out in the mean of a pause.
    changes_per_s
        Most changes of a state per second, over 5 s.

    """

    memory_mb: float
    error_n: float
    error_rms_n: float
    changes_per_s: float


@dataclass
class SoakOutcome:
    """
    What a soak leaves.

    Attributes
    ----------
    simulated_s
        How long it was.
    episodes
        How many of each kind.
    minutes
        What was seen in each.
    unsafe
        Torques that are not finite or beyond limits, forces beyond the ceiling for long, and
        more than 40 N on what is in the way, as faults are judged.
    alternating
        States that changed more than twice a second for 5 s.
    oscillating
        Forces that oscillated while nothing happened, as runs are judged (`oscillation`): in a
        pause, or in up to seven in a row.
    stuck
        Episodes after which things were not as commanded, whatever the operator tried.
    helped
        How often the operator had to say that he wants what he had commanded.
    counts
        Of all these problems, also of what is not described.

    """

    simulated_s: float = 0.0
    episodes: Counter[str] = field(default_factory=Counter)
    minutes: list[Minute] = field(default_factory=list)
    unsafe: list[str] = field(default_factory=list)
    alternating: list[str] = field(default_factory=list)
    oscillating: list[str] = field(default_factory=list)
    stuck: list[str] = field(default_factory=list)
    helped: int = 0
    counts: Counter[str] = field(default_factory=Counter)


class Soak:
    """
    A closed loop under random commands and faults.

    Parameters
    ----------
    setup
        Arm, surfaces, controller.
    seed
        Of all that happens.

    Attributes
    ----------
    outcome
        What has come of it so far.

    """

    def __init__(self, setup: Setup, seed: int) -> None:
        self._loop = ClosedLoop(setup, commanded=True)
        self._random = np.random.default_rng(seed)
        self._faults = [fault for fault in faults_of(PROCESS).values() if passes_over(fault)]
        config = setup.controller
        self._names, self._rate, self._period = config.contact_names, config.rate, config.period
        limit = torque_limit(setup)
        step = np.broadcast_to(config.limits.torque_rate or np.inf, limit.shape) * config.period
        self._limit: list[float] = (limit * (1.0 + TOLERANCE)).tolist()
        self._step: list[float] = (step * (1.0 + TOLERANCE)).tolist()
        self._ceiling = FORCE_MARGIN * config.contact_state.force_ceiling
        self._smallest = config.contact_state.smallest_force
        normals = np.array([config.contacts[name].normal_world for name in self._names])
        across = np.eye(3) - np.linalg.pinv(normals) @ normals
        directions, sizes, _ = np.linalg.svd(across)
        self._free = directions[:, sizes > 0.5].T  # directions in which no contact is
        self._wanted = dict.fromkeys(self._names, 0.0)
        self._target: Vector | None = None
        self._above = 0
        self._obstructed = False
        self._fastest_change = 0.0
        self._quiet_errors: list[float] = []
        self._quiet_squares: list[float] = []
        # Of the last pauses, errors and what was wanted. Each has half a window or more left.
        self._pauses: deque[tuple[Matrix, Vector]] = deque(maxlen=STRETCH)
        self._doing = 'start'
        self.outcome = SoakOutcome()
        self._last: list[float] = self._loop.command.tolist()
        self._advance()
        pose = self._loop.control.controller.controller.arm.pose
        # Of the start, not of the moment: errors of the orientation would add up.
        self._start, self._turn = pose.position_world.copy(), pose.quaternion_xyzw.copy()

    def close(self) -> None:
        """Give the simulator's memory back."""
        self._loop.close()

    def run(self, duration: float) -> SoakOutcome:
        """Let things happen for a simulated time [s]; the last episode is gone through."""
        self._command_forces()
        self._settle()
        while self.outcome.simulated_s < duration:
            kind = str(self._random.choice(EPISODES, p=CHANCES))
            self.outcome.episodes[kind] += 1
            self._doing = kind
            self._episode(kind)
            self._settle()
            self._wait(float(self._random.uniform(*PAUSE)), quiet=True)
        return self.outcome

    def _episode(self, kind: str) -> None:
        if kind == 'forces':
            self._command_forces()
        elif kind == 'motion':
            self._move()
        elif kind == 'hold':
            self._loop.control.hold(True)
            self._wait(float(self._random.uniform(*HOLD_TIME)))
            self._loop.control.hold(False)
        else:
            self._break(2 if kind == 'two faults' else 1)

    def _command_forces(self) -> None:
        for name in self._names:
            released = self._random.random() < RELEASED_SHARE
            self._wanted[name] = 0.0 if released else float(
                self._random.uniform(self._smallest, LARGEST_FORCE))
        self._loop.control.set_forces(self._wanted)

    def _move(self) -> None:
        """Go along a straight line, at rest at both ends."""
        before = self._start if self._target is None else self._target
        goal = self._start + self._random.uniform(-REACH, REACH, len(self._free)) @ self._free
        duration = max(1.0, 1.875 * float(np.linalg.norm(goal - before)) / FASTEST)
        for k in range(1, round(duration * self._rate) + 1):
            s, ds, dds = quintic(k * self._period, duration)
            way = goal - before
            self._loop.control.set_motion(MotionReading(
                before + s * way, self._turn, np.concatenate([ds * way, np.zeros(3)]),
                np.concatenate([dds * way, np.zeros(3)])))
            self._advance()
        self._target = goal

    def _break(self, count: int) -> None:
        chosen: list[Fault] = []
        while len(chosen) < count:
            fault = self._faults[int(self._random.integers(len(self._faults)))]
            if all(fault.input != other.input for other in chosen):
                chosen.append(fault)
        self._doing = ' + '.join(f'{fault.input} {fault.kind}' for fault in chosen)
        found = [Occurrence(fault, self._random, self._loop) for fault in chosen]
        for _ in range(max(each.lasts for each in found)):
            self._advance(found)

    def _settle(self) -> None:
        """Wait until all is as commanded, and help if it does not come to that by itself."""
        for attempt in range(4):
            for _ in range(round(SETTLE_TIME / 0.5)):
                if self._wait(0.5):
                    return
            self.outcome.helped += 1
            if attempt == 1:  # let go of everything first
                self._loop.control.set_forces(dict.fromkeys(self._names, 0.0))
                self._wait(1.0)
            self._loop.control.set_forces(self._wanted)
            with contextlib.suppress(CommandError):  # there may be nothing to try again
                self._loop.control.retry()
        self._report('stuck', f'{self._loop.status.contact_states}, '
                     f'{self._loop.status.reaction} {self._loop.status.causes}')
        self._loop.control.restart()
        self._last = self._loop.command.tolist()

    def _wait(self, duration: float, quiet: bool = False) -> bool:
        """Wait, and return whether all was as commanded then; `quiet` if it should be."""
        forces = []
        for _ in range(round(duration * self._rate)):
            self._advance()
            forces.append(self._loop.true_forces)
        wanted = np.array(list(self._wanted.values()))
        errors = np.array(forces) - wanted
        error = np.abs(errors.mean(axis=0))
        if quiet:
            self._quiet_errors += error[wanted > 0.0].tolist()
            self._quiet_squares += (errors ** 2).mean(axis=0)[wanted > 0.0].tolist()
            self._pauses.append((errors, wanted))
            self._look_for_oscillations()
        states = self._loop.status.contact_states
        held = all(state == ContactState.HOLDING.value
                   for state, force in zip(states, wanted) if force > 0.0)
        return held and self._loop.status.reaction == 'none' and bool(
            (error <= np.maximum(1.0, OFF * wanted))[wanted > 0.0].all())

    def _look_for_oscillations(self) -> None:
        """Find out whether a force has oscillated in the last pauses, which are left then."""
        half = round(0.5 * WINDOW * self._rate)
        errors, wanted = [], []
        for error, asked in self._pauses:
            # As many half windows as there are, and one that keeps it apart from the next.
            length = len(error) // half * half
            errors += [error[:length], np.full((half, len(asked)), np.nan)]
            wanted += [np.tile(asked, (length + half, 1))]
        error, asked = np.concatenate(errors), np.concatenate(wanted)
        for name, of_contact, command in zip(self._names, error.T, asked.T):
            for found in oscillations(
                    of_contact, command, np.ones(len(error), dtype=bool), self._rate):
                self._pauses.clear()
                self._report('oscillating', f'{name} at {found.frequency:.0f} Hz with '
                             f'{found.rms:.2g} N rms')

    def _advance(self, faults: Sequence[Occurrence] = ()) -> None:
        """Take a tick, and look at what is never to happen."""
        loop, outcome = self._loop, self.outcome
        advance_with(faults, loop)
        torque = loop.command.tolist()
        problem = self._speaks_against(torque)
        if problem:
            self._report('unsafe', problem)
        self._last = torque
        force = max(loop.true_forces.tolist())
        self._above = self._above + 1 if force > self._ceiling else 0
        if self._above == round(FORCE_TIME * self._rate):
            self._report('unsafe', f'{force:.0f} N for {FORCE_TIME:g} s')
        met = max(loop.obstacle_forces.tolist(), default=0.0)
        if met > MET_FORCE and not self._obstructed:
            self._report('unsafe', f'{met:.0f} N on what is in the way')
        self._obstructed = met > MET_FORCE
        outcome.simulated_s = loop.tick * self._period
        if loop.tick % round(self._rate) == 0:
            self._each_second()

    def _speaks_against(self, torque: list[float]) -> str:
        """Return what is wrong with a command, joint by joint: numpy takes ten times as long."""
        if not all(map(math.isfinite, torque)):
            return 'torque not finite'
        for now, before, limit, step in zip(
                torque, self._last, self._limit, self._step, strict=True):
            if abs(now) > limit or abs(now - before) > step:
                return 'torque or its rate beyond the limit'
        return ''

    def _each_second(self) -> None:
        rates = self._loop.control.events.alternating(self._loop.control.time)
        if rates:
            self._report('alternating', ', '.join(
                f'{name} {rate:.1f}/s' for name, rate in rates.items()))
        self._fastest_change = max([self._fastest_change, *rates.values()])
        if round(self.outcome.simulated_s) % 60:
            return
        self.outcome.minutes.append(minute_of(
            resident_memory(), self._quiet_errors, self._quiet_squares, self._fastest_change))
        self._quiet_errors, self._quiet_squares, self._fastest_change = [], [], 0.0

    def _report(self, what: str, text: str) -> None:
        self.outcome.counts[what] += 1
        found: list[str] = getattr(self.outcome, what)
        if len(found) < MOST_REPORTED:
            found.append(f'{self.outcome.simulated_s:.1f} s, {self._doing}: {text}')


def minute_of(
    memory_mb: float, errors: Sequence[float], squares: Sequence[float], changes_per_s: float,
) -> Minute:
    """Return a minute from the mean errors [N] and mean squares [N^2] of its pauses."""
    return Minute(memory_mb, float(np.mean(errors or [np.nan])),
                  float(np.sqrt(np.mean(squares or [np.nan]))), changes_per_s)


def passes_over(fault: Fault) -> bool:
    """Return whether the world is as before after a fault."""
    return not isinstance(fault.action, PlantEdit) or fault.action.end is not None


def resident_memory(process: int | str = 'self') -> float:
    """Return the resident memory of a process [MB]; where there is no such thing, our largest."""
    try:
        pages = int(Path(f'/proc/{process}/statm').read_text(encoding='ascii').split()[1])
        return pages * resource.getpagesize() / 1e6
    except (OSError, IndexError, ValueError):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
