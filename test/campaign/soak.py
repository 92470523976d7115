"""
Hours of random commands, faults and pauses in process: `make soak`, with options in SOAK_ARGS.

After each episode, a command or a fault, every force has to be as commanded again. Never may a
torque or its rate be beyond its limit, a force beyond the ceiling for long, an obstacle be
pressed by more than 40 N, a state alternate, or a force oscillate while nothing happens: exit
code 1. The episodes are written to a file of JSON lines.
"""

import argparse
from collections import deque
import contextlib
from itertools import chain, pairwise
import math
from pathlib import Path
import sys

from joblib import delayed, Parallel
from multicontact_control.algebra import quintic_blend
from multicontact_control.control.tasks import MotionReading
from multicontact_control.errors import CommandError
from multicontact_control.faults import fault_run
from multicontact_control.faults.outcomes import (
    find_violations,
    Observation,
    OBSTACLE_FORCE,
)
from multicontact_control.faults.vocabulary import FAULTS, PlantEdit
from multicontact_control.judging.oscillation import find_oscillations
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.supervision.contacts import HOLDING, STATE_NAMES
import numpy as np
import pandas as pd
from rich.progress import track
from scipy.linalg import null_space
from sim_bridge.robots import DEFAULT, find_robot

LONGEST_PART = 3600.0  # s of a seed
LARGEST_FORCE = 25.0  # N, that is commanded
REACH, FASTEST = 0.1, 0.2  # m to either side of the start, m/s
PAUSE = (2.2, 4.0)  # s between episodes; an oscillation shows within 2
EPISODES = {
    'forces': 0.35,
    'motion': 0.3,
    'hold': 0.05,
    'fault': 0.24,
    'two faults': 0.06,
}
SETTLE_TIME = 15.0  # s
ATTEMPTS = 4  # of that, from the second on with the operator's help
OFF = 0.15  # of the command, and 1 N: mean error over 0.5 s that is as commanded
CHANGES_TIME = 5.0  # s
MOST_CHANGES = 10  # in that time, beyond which a state alternates


def is_passing(fault):
    """Return whether the world is as before after a fault."""
    return not (isinstance(fault.action, PlantEdit) and fault.action.end is None)


class Soak:
    """A closed loop in process under random commands and faults, until closed."""

    def __init__(self, plant, seed):
        self.setup = fault_run.resolve_with_obstacles('quick', plant, seed)
        self.loop = ClosedLoop(self.setup, commanded=True)
        self._random = np.random.default_rng(seed)
        self._faults = [fault for fault in FAULTS.values() if is_passing(fault)]
        config = self.setup.controller
        self._rate = config.rate
        self._period = config.period
        self._states = deque(maxlen=round(CHANGES_TIME * config.rate))
        contacts = [config.contacts[name] for name in config.contact_names]
        normals = np.array([contact.normal_world for contact in contacts])
        self._free = null_space(normals).T  # directions in which no contact is
        self.wanted = dict.fromkeys(config.contact_names, 0.0)
        pose = self.loop.advance().pose
        self._before = self.loop.command.copy()
        self._begin_episode()
        # Of the start, not of the moment: errors of the orientation would add up.
        self._start = pose.position_world.copy()
        self._turn = pose.quaternion_xyzw.copy()
        self._target = self._start
        self.command_forces()
        self.settle()

    def _begin_episode(self):
        self._problems = set()
        self._torques, self._forces, self._obstacle_forces = [], [], []

    def episode(self):
        """Let one thing happen, and return its line."""
        kind = str(self._random.choice(list(EPISODES), p=list(EPISODES.values())))
        if kind == 'forces':
            self.command_forces()
        elif kind == 'motion':
            self._move()
        elif kind == 'hold':
            self.loop.control.hold(True)
            self.wait(float(self._random.uniform(0.5, 3.0)))
            self.loop.control.hold(False)
        else:
            kind = self._break(2 if kind == 'two faults' else 1)
        self.settle()
        _, errors = self.wait(float(self._random.uniform(*PAUSE)))
        self._note_oscillations(errors)
        seen = Observation(
            torque=np.array(self._torques),
            torque_before=self._before,
            force=np.array(self._forces),
            time=self._period * np.arange(len(self._forces)),
            reaction='',
        )
        self._problems.update(find_violations(seen, self.setup)[0])
        obstacle_force = max(self._obstacle_forces, default=0.0)
        if obstacle_force > OBSTACLE_FORCE:
            self._problems.add(f'{obstacle_force:.0f} N on an obstacle')
        problems = sorted(self._problems)
        self._before = self._torques[-1]
        self._begin_episode()
        return {
            'time_s': round(self.loop.tick * self._period, 3),
            'episode': kind,
            'problems': problems,
            'error_n': float(np.abs(errors.mean(axis=0)).max()),
        }

    def _note_oscillations(self, errors):
        """Note the forces that oscillate, from their errors, shape (ticks, r) [N]."""
        counted = np.ones(len(errors), dtype=bool)
        for (name, force), error in zip(self.wanted.items(), errors.T):
            commanded = np.full(len(error), force)
            for line in find_oscillations(error, commanded, counted, self._rate):
                self._problems.add(
                    f'{name} oscillates at {line.frequency:.0f} Hz '
                    f'with {line.rms:.2g} N rms'
                )

    def command_forces(self):
        """Command another force at every contact, or none."""
        smallest = self.setup.controller.contact_state.smallest_force
        for name in self.wanted:
            pressed = self._random.random() > 0.1
            force = float(self._random.uniform(smallest, LARGEST_FORCE))
            self.wanted[name] = force if pressed else 0.0
        self.loop.control.set_forces(self.wanted)

    def _move(self):
        aside = self._random.uniform(-REACH, REACH, len(self._free))
        goal = self._start + aside @ self._free
        before = self._target
        way = np.append(goal - before, np.zeros(3))
        duration = max(1.0, 1.875 * float(np.linalg.norm(way)) / FASTEST)
        for k in range(1, round(duration * self._rate) + 1):
            s, ds, dds = quintic_blend(k * self._period, duration)
            place = before + s * way[:3]
            motion = MotionReading(place, self._turn, ds * way, dds * way)
            self.loop.control.set_motion(motion)
            self.advance()
        self._target = goal

    def _break(self, count):
        """Let faults of different inputs happen at the same time; return their names."""
        shuffled = self._random.permutation(self._faults)
        by_input = {fault.input: fault for fault in shuffled}
        chosen = self._random.permutation(list(by_input.values()))[:count]
        occurrences = [
            fault_run.FaultOccurrence(fault, self._random, self.loop)
            for fault in chosen
        ]
        for _ in range(max(each.duration_ticks for each in occurrences)):
            self.advance(occurrences)
        return ' + '.join(f'{fault.input} {fault.kind}' for fault in chosen)

    def settle(self):
        """Wait until all is as commanded, and help if it does not come to that by itself."""
        for attempt in range(ATTEMPTS):
            for _ in range(round(SETTLE_TIME / 0.5)):
                as_commanded, _ = self.wait(0.5)
                if as_commanded:
                    return
            if attempt == 1:  # let go of everything first
                self.loop.control.set_forces(dict.fromkeys(self.wanted, 0.0))
                self.wait(1.0)
            self.loop.control.set_forces(self.wanted)
            with contextlib.suppress(CommandError):  # there may be nothing to try again
                self.loop.control.retry()
        status = self.loop.status
        self._problems.add(
            f'stuck: {status.contact_states}, {status.reaction} {status.causes}'
        )
        self.loop.control.restart()

    def wait(self, duration):
        """Wait [s]; return whether all was as commanded, and the errors, shape (ticks, r) [N]."""
        forces = []
        for _ in range(round(duration * self._rate)):
            self.advance()
            forces.append(self.loop.sample.contact_force)
        status = self.loop.status
        wanted = np.array(list(self.wanted.values()))
        pressed = wanted > 0.0
        errors = np.array(forces) - wanted
        held = np.array(status.contact_states) == STATE_NAMES[HOLDING]
        near = np.abs(errors.mean(axis=0)) <= np.maximum(1.0, OFF * wanted)
        as_commanded = bool((held & near)[pressed].all())
        return as_commanded and status.reaction == 'none', errors

    def advance(self, faults=()):
        loop = self.loop
        fault_run.advance_with_faults(faults, loop)
        self._torques.append(loop.command.copy())
        self._forces.append(float(loop.sample.contact_force.max()))
        obstacle_force = loop.plant.contacts.obstacles.max(initial=0.0)
        self._obstacle_forces.append(float(obstacle_force))
        self._states.append((loop.status.reaction, *loop.status.contact_states))
        if loop.tick % round(self._rate) == 0:
            for name, states in zip(('reaction', *self.wanted), zip(*self._states)):
                changes = sum(a != b for a, b in pairwise(states))
                if changes > MOST_CHANGES:
                    self._problems.add(f'{name} alternates')


def episodes(plant, seed, duration):
    """Return the lines of the episodes of a time [s]."""
    soak = Soak(plant, seed)
    lines = []
    with contextlib.closing(soak.loop):
        while not lines or lines[-1]['time_s'] < duration:
            lines.append({'plant': plant, 'seed': seed, **soak.episode()})
    return lines


def main(arguments=None):
    """Run the soak; return the exit code."""
    parser = argparse.ArgumentParser(
        prog='make soak',
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        '--hours', type=float, default=1.0, help='of all seeds (%(default)s)'
    )
    parser.add_argument(
        '--plants',
        nargs='+',
        default=[*find_robot(DEFAULT).file.plants],
        help='default: %(default)s',
    )
    parser.add_argument('--seed', type=int, default=0, help='the first')
    parser.add_argument(
        '--out', type=Path, default=Path('runs/soak.jsonl'), help='%(default)s'
    )
    options = parser.parse_args(arguments)
    count = max(len(options.plants), math.ceil(3600.0 * options.hours / LONGEST_PART))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    duration = 3600.0 * options.hours / count
    jobs = []
    for k in range(count):
        plant = options.plants[k % len(options.plants)]
        jobs.append(delayed(episodes)(plant, options.seed + k, duration))
    parts = track(Parallel(-1, return_as='generator')(jobs), 'soak', count)
    lines = pd.DataFrame(list(chain.from_iterable(parts)))
    lines.to_json(options.out, orient='records', lines=True)
    lines['found'] = lines.problems.map(len)
    summary = lines.groupby(['plant', 'seed']).agg(
        seconds=('time_s', 'max'),
        episodes=('episode', 'size'),
        error_n=('error_n', 'mean'),
        problems=('found', 'sum'),
    )
    print(summary.to_string())
    problems = lines[lines.found > 0]
    print(problems.to_string())
    return 1 if len(problems) else 0


if __name__ == '__main__':
    sys.exit(main())
