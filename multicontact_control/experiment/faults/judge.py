"""What became of a fault of a running graph, judged by what was on its topics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from multicontact_control.arrays import Vector
from multicontact_control.experiment.faults.graph_vocabulary import GraphFault
from multicontact_control.experiment.faults.graph_watch import (
    CHECKED,
    finite,
    GraphWatch,
    ReceivedMessage,
    Report,
)
from multicontact_control.experiment.faults.in_process import FaultRow, FORCE_MARGIN
from multicontact_control.experiment.graph.spec import CONTROLLER, SIM
from multicontact_control.experiment.scenario import Setup
from multicontact_control.nodes import topics
from multicontact_control.supervision.fallback import SEVERITY
import numpy as np

GRAPH = 'graph'
SILENT, PAUSED, NONE = 'silent', 'paused', 'none'
SILENCE = 0.1  # s without a command while samples come that counts as silence
STOPPED = 0.3  # s of silence that a controller which should go on may not be guilty of
RETRACT_TIME = 0.1  # s, in which a contact beyond the ceiling must have been left


@dataclass(frozen=True)
class Window:
    """
    The time of one fault.

    Attributes
    ----------
    begin, end, recovered
        When it began and ended, and when all was well again [s]; -1 if it never was.

    """

    begin: float
    end: float
    recovered: float


class Judge:
    """
    Judges the faults of one graph.

    Parameters
    ----------
    setup
        Limits, plant.
    watch
        What was said.
    wanted
        The commanded force per contact [N].

    """

    def __init__(self, setup: Setup, watch: GraphWatch, wanted: dict[str, float]) -> None:
        config = setup.controller
        self._watch, self._wanted, self._plant = watch, wanted, setup.plant_name
        self._joints = config.robot.joint_names
        self._limit = np.array(config.torque_limit)
        self._step = np.array(config.limits.torque_rate) * config.period
        self._ceiling = config.contact_state.force_ceiling
        self._rate = config.rate

    def row(
        self, fault: GraphFault, seed: int, window: Window, problems: Sequence[str] = (),
    ) -> FaultRow:
        """
        Return the row of a fault.

        Parameters
        ----------
        fault, seed, window
            Which, and when.
        problems
            What is known to have gone wrong already.

        """
        found = set(problems)
        said = {topic: self._watch.since(topic, window.begin) for topic in CHECKED}
        for topic, messages in said.items():
            if not all(map(finite, messages)):
                found.add(f'{topic.name} not finite')
        peak_torque = self._judge_torques(said[topics.EFFORT_COMMAND], fault, found)
        force_time, forces = self._forces(said[topics.TRUE_FORCES])
        calm = self._judge_forces(force_time, forces, window, found)
        silences = self._silences(said, window)
        if fault.goes_on and any(end - begin > STOPPED for begin, end in silences):
            found.add('commands stopped')
        self._judge_desired(said[topics.DESIRED_FORCES], found)
        back = max([calm, *(end for _, end in silences if end > window.begin)])
        never = window.recovered < 0.0
        return FaultRow(
            kind=fault.kind, input=fault.input, seed=seed,
            reaction=self._reaction(said[topics.DESIRED_FORCES], silences, window),
            time_to_safe_s=-1.0 if never else round(max(0.0, back - window.begin), 3),
            peak_force_n=round(float(forces.max(initial=0.0)), 3),
            peak_torque_fraction=round(peak_torque, 5), safe=not found, plant=self._plant,
            phase='', problems=', '.join(sorted(found)), where=GRAPH)

    def _judge_torques(
        self, commands: list[ReceivedMessage], fault: GraphFault, found: set[str],
    ) -> float:
        """Return the largest torque over its limit."""
        if not commands:
            return 0.0
        torques = np.array([[x.values[name] for name in self._joints] for x in commands])
        fraction = float((np.abs(torques) / self._limit).max())
        if not fraction <= 1.0 + 1e-9:
            found.add('torque beyond its limit')
        # The first command of a new process or activation starts from what the drives do.
        if fault.input != CONTROLLER and (
                np.abs(np.diff(torques, axis=0)) > self._step * (1.0 + 1e-9)).any():
            found.add('torque rate beyond its limit')
        return fraction

    def _forces(self, said: list[ReceivedMessage]) -> tuple[Vector, Vector]:
        """Return when, and the largest true force then [N]."""
        return (np.array([x.time for x in said]),
                np.array([max(x.values.values()) for x in said]))

    def _judge_forces(
        self, time: Vector, forces: Vector, window: Window, found: set[str],
    ) -> float:
        """Return when every force was, and stayed, within the ceiling."""
        longest = begin = 0.0
        for now, force in zip(time.tolist(), forces.tolist()):
            beyond = force > FORCE_MARGIN * self._ceiling
            begin = (begin or now) if beyond else 0.0
            longest = max(longest, now - begin if begin else 0.0)
        if longest > RETRACT_TIME:
            found.add('force beyond the ceiling for too long')
        over = time[forces > self._ceiling]
        return float(over[-1]) if over.size else window.begin

    def _silences(
        self, said: dict[topics.Topic, list[ReceivedMessage]], window: Window,
    ) -> list[tuple[float, float]]:
        """Return from when to when samples came, but no commands."""
        samples = np.array([x.time for x in said[topics.TRUE_FORCES]])
        edges = [window.begin, *(x.time for x in said[topics.EFFORT_COMMAND])]
        if samples.size:
            # Samples were looked for after the commands, on a busy machine long after.
            edges.append(min(float(samples[-1]), self._watch.polled))
        found = []
        for begin, end in zip(edges, edges[1:]):
            if end - begin > SILENCE and (
                    np.count_nonzero((samples > begin) & (samples < end))
                    > 0.5 * (end - begin) * self._rate):
                found.append((begin, end))
        return found

    def _judge_desired(self, desired: list[ReceivedMessage], found: set[str]) -> None:
        """Note if the controller wants more than the rightful user."""
        if any(x.values.get(name, 0.0) > force + 1e-6
               for x in desired for name, force in self._wanted.items()):
            found.add('obeyed a command it should have refused')

    def _reaction(
        self, desired: list[ReceivedMessage], silences: list[tuple[float, float]], window: Window,
    ) -> str:
        """Return the reaction that was told of for longest, or else what was seen."""
        told = self._told(window)
        if silences:
            # Who is silent counts no ticks.
            told[SILENT] = round(sum(end - begin for begin, end in silences) * self._rate)
        if told:
            # Not the strongest: a busy machine adds a few ticks of its own.
            return max(told, key=lambda name: (told[name], (*SEVERITY, SILENT).index(name)))
        # A law that is not at work wants no force, or says nothing of it.
        times = [window.begin, *(x.time for x in desired if x.time < window.end), window.end]
        paused = any(not any(x.values.values()) for x in desired if x.time < window.end) or (
            max(np.diff(times)) > SILENCE)
        return PAUSED if paused else NONE

    def _told(self, window: Window) -> Counter[str]:
        """Return in how many ticks there was each reaction, by the controller's counts."""
        told: Counter[str] = Counter()
        before: dict[str, int] = {}
        for report in self._watch.reports:
            if report.node != CONTROLLER:
                continue
            counts = _reaction_ticks(report)
            if report.time >= window.begin:
                for name, ticks in counts.items():
                    known = before.get(name, 0)
                    # Counts that have fallen are those of a new process or activation.
                    told[name] += ticks - known if ticks >= known else ticks
            before = counts
            if report.time >= window.end:
                break  # what comes later tells of what came later
        return +told


def _reaction_ticks(report: Report) -> dict[str, int]:
    """Return in how many ticks there was each reaction, as diagnostics have it."""
    return {name: int(values[key]) for _, _, values in report.parts.values()
            for name in SEVERITY[1:] if (key := f'ticks with {name}') in values}


def busy_share(reports: Iterable[Report], period: float) -> float:
    """
    Return the share of seconds in which the machine was too busy for the control rate.

    That is, in which half of the commands came later than half a period after their samples, as
    the simulator's diagnostics have it.
    """
    latencies = [float(text) for report in reports if report.node == SIM
                 for _, _, values in report.parts.values()
                 if (text := values.get('latency_us_p50', 'none')) != 'none']
    return float(np.mean(np.array(latencies) > 0.5e6 * period)) if latencies else 0.0
