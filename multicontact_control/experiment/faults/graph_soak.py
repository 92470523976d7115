"""
A long time of work over a graph, in real time: random forces and faults, and what must never be.

The arm slides to and fro. An episode is a new command or a fault; after it, every force has to be
as commanded again. Then nothing happens for a while, and in half of these pauses the arm rests.
What is not safe, or does not come back, ends the graph; the next one begins anew.
"""

from __future__ import annotations

from pathlib import Path
import shutil
from tempfile import mkdtemp
import time

from multicontact_control.errors import RunError
from multicontact_control.experiment.faults.fault import GRAPH
from multicontact_control.experiment.faults.graph_session import END_TIME, FaultSession
from multicontact_control.experiment.faults.graph_watch import (
    busy_share,
    observe,
    ReceivedMessage,
    Window,
)
from multicontact_control.experiment.faults.in_graph import break_once, MAX_FAILURES
from multicontact_control.experiment.faults.judge import never_allowed
from multicontact_control.experiment.faults.vocabulary import faults_of
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.spec import CONTROLLER
from multicontact_control.experiment.oscillation import oscillations
from multicontact_control.experiment.scenario import Setup
from multicontact_control.experiment.soak import (
    minute_of,
    MOST_REPORTED,
    PAUSE,
    PROBLEMS,
    resident_memory,
    SoakOutcome,
)
from multicontact_control.nodes import topics
import numpy as np

FORCES = (5.0, 20.0)  # N, that are commanded
FAULT_CHANCE = 0.6  # of an episode, to be a fault
MINUTE = 60.0  # s
REST_CHANCE = 0.5  # of a pause, that the arm rests in it
REST_TIME = 3.0  # s of samples; an oscillation shows within 2
TOO_FAST = 2.0  # changes of a state per second, over 5 s


class GraphSoak:
    """
    Graphs under random commands and faults.

    Torques and largest forces are judged all the time, but for up to 0.3 s before a fault. Errors
    and oscillation of forces are those at rest.

    Parameters
    ----------
    setup
        Arm, surfaces, controller, estimator.
    seed
        Of all that happens.

    Attributes
    ----------
    outcome
        What has come of it so far. Its memory is that of all nodes together; `stuck` are graphs
        that did not come up, or not back.

    """

    def __init__(self, setup: Setup, seed: int) -> None:
        self.outcome = SoakOutcome()
        self._setup, self._random = setup, np.random.default_rng(seed)
        self._faults = list(faults_of(GRAPH).values())
        self._begin = self._next_minute = self._looked = 0.0
        self._errors: list[float] = []
        self._squares: list[float] = []
        self._fastest_change = 0.0

    def run(self, duration: float) -> SoakOutcome:
        """
        Let things happen for a time [s], from when the first graph is up.

        Bags and logs are kept if something went wrong.
        """
        folder = Path(mkdtemp(prefix='soak-'))
        self._begin = time.monotonic()
        failures = number = 0
        with reserve_domain() as domain_id:
            while self._elapsed() < duration and failures < MAX_FAILURES:
                number += 1
                try:
                    with FaultSession(self._setup, folder / f'{number:03d}', domain_id) as session:
                        failures = 0
                        if not self.outcome.episodes:
                            self._begin = time.monotonic()
                            self._next_minute = self._begin + MINUTE
                        if self._run_in(session, duration):
                            for problem in session.end_all():
                                self._report('unsafe', problem)
                except RunError as error:
                    failures += 1
                    self._report('stuck', str(error).splitlines()[0])
        for what in PROBLEMS:
            if found := getattr(self.outcome, what):
                found[0] += f' (see {folder})'
                break
        else:
            shutil.rmtree(folder)
        return self.outcome

    def _elapsed(self) -> float:
        self.outcome.simulated_s = time.monotonic() - self._begin
        return self.outcome.simulated_s

    def _run_in(self, session: FaultSession, duration: float) -> bool:
        """Let things happen in a graph until the time is over; False if one was not safe."""
        while self._elapsed() < duration:
            kind = 'fault' if self._random.random() < FAULT_CHANCE else 'forces'
            self.outcome.episodes[kind] += 1
            begin, largest = time.time(), dict(session.wanted)
            if kind == 'forces':
                session.wanted.update(
                    {name: float(self._random.uniform(*FORCES)) for name in session.wanted})
                largest = {name: max(force, largest[name])
                           for name, force in session.wanted.items()}
                session.recover()
            else:
                fault = self._faults[int(self._random.integers(len(self._faults)))]
                row = break_once(session, fault, int(self._random.integers(2 ** 31)))
                if not row.safe:
                    self._report('unsafe', f'{fault.input} {fault.kind}: {row.problems}')
                    return False
                begin = session.watch.polled
            self._pause(session)
            now = session.watch.polled
            problems, _ = never_allowed(observe(
                session.watch, self._setup, largest, Window(begin, now, now)), self._setup)
            if problems:
                self._report('unsafe', f'after {kind}: {", ".join(sorted(problems))}')
                return False
        return True

    def _pause(self, session: FaultSession) -> None:
        """Let nothing happen for a while, and look at what is never to happen."""
        if self._random.random() < REST_CHANCE:
            self._rest(session)
        else:
            session.spin(float(self._random.uniform(*PAUSE)))
        fresh = [x for x in session.watch.reports if x.time > self._looked]
        self._looked = fresh[-1].time if fresh else self._looked
        fastest = max((float(x.values.get('fastest_change_hz', 0.0)) for x in fresh
                       if x.node == CONTROLLER), default=0.0)
        self._fastest_change = max(self._fastest_change, fastest)
        # A machine that is too busy for real time makes changes of its own.
        if fastest > TOO_FAST and busy_share(fresh, self._setup.controller.period) == 0.0:
            self._report('alternating', f'{fastest:.1f}/s')
        if time.monotonic() >= self._next_minute:
            self._next_minute += MINUTE
            self.outcome.minutes.append(minute_of(
                sum(map(resident_memory, session.processes.numbers)),
                self._errors, self._squares, self._fastest_change))
            self._errors, self._squares, self._fastest_change = [], [], 0.0

    def _rest(self, session: FaultSession) -> None:
        """Let the arm rest, and look at the forces."""
        session.operator.stop()
        session.spin(END_TIME)
        begin, rate = time.time(), self._setup.controller.rate
        said: list[ReceivedMessage] = []

        def enough() -> bool:
            said[:] = session.watch.since(topics.TRUE_FORCES, begin)
            return len(said) >= REST_TIME * rate
        # Not by the clock: a machine that is too busy for real time takes longer for it.
        session.wait(enough, 'samples')
        session.wait(session.operator.start, 'a controller that obeys')
        errors = np.array([[x.values[name] - force for name, force in session.wanted.items()]
                           for x in said])
        self._errors += np.abs(errors.mean(axis=0)).tolist()
        self._squares += (errors ** 2).mean(axis=0).tolist()
        for (name, force), error in zip(session.wanted.items(), errors.T):
            for found in oscillations(
                    error, np.full(len(said), force), np.ones(len(said), dtype=bool), rate):
                self._report('oscillating', f'{name} at {found.frequency:.0f} Hz with '
                             f'{found.rms:.2g} N rms')

    def _report(self, what: str, text: str) -> None:
        self.outcome.counts[what] += 1
        found: list[str] = getattr(self.outcome, what)
        if len(found) < MOST_REPORTED:
            found.append(f'{self._elapsed():.1f} s: {text}')
