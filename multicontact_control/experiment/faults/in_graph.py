"""The fault campaign over the graph: real nodes, in real time, one fault after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import contextlib
from pathlib import Path
import time

from multicontact_control.errors import RunError
from multicontact_control.experiment.display import count_bar
from multicontact_control.experiment.faults.fault import Fault, GRAPH
from multicontact_control.experiment.faults.graph_session import FaultSession
from multicontact_control.experiment.faults.graph_watch import busy_share, observe, Window
from multicontact_control.experiment.faults.judge import FaultRow, judge
from multicontact_control.experiment.faults.vocabulary import faults_of, quick_faults
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.processes import NodeEndedError
from multicontact_control.experiment.graph.watching import collected_signals
from multicontact_control.experiment.scenario import resolve
from multicontact_control.files import file_name
import numpy as np
from rich.console import Console

SEEDS, QUICK_SEEDS = 2, 1
QUIET = (0.0, 0.3)  # s of normal operation before a fault
BUSY = 0.1  # share of the time from which on to say so
MAX_FAILURES = 2  # graphs in a row that don't come up, for a plant to be given up
REPORT_TIMEOUT = 1.5  # s until the controller's diagnostics, one a second, tell of it
SCENARIO = 'quick'  # what is not commanded over topics: limits, estimator
FOLDER = 'graphs'
NOT_RUN = 'not run: no graph came up for it'

OnProgress = Callable[[int, int], None]
Task = tuple[Fault, int]  # and its seed


class _InterruptedError(Exception):
    """A signal came."""


def graph_tasks(
    plants: Sequence[str], seed: int, *, quick: bool = False,
) -> dict[str, list[Task]]:
    """
    Return the faults of a campaign and their seeds, by plant, in random order.

    Parameters
    ----------
    plants
        Where they happen.
    seed
        Seeds of the faults count from here.
    quick
        One fault of every kind, on the last plant alone.

    """
    plants, seeds = (plants[-1:], QUICK_SEEDS) if quick else (plants, SEEDS)
    kinds = quick_faults(GRAPH, seed) if quick else list(faults_of(GRAPH).values())
    tasks = [(kind, seed + n) for n in range(seeds) for kind in kinds]
    orders = np.random.default_rng(seed)
    return {plant: [tasks[i] for i in orders.permutation(len(tasks)).tolist()]
            for plant in plants}


class GraphCampaign:
    """
    Faults in running graphs, one graph after the other.

    Parameters
    ----------
    tasks
        The faults and their seeds, by plant.
    seed
        Of the plants.
    out
        Folder; every graph gets one of its own in it.
    on_progress
        Called with the faults done and all.

    Attributes
    ----------
    rows
        What became of the faults so far.
    interrupted
        Signal that ended it early, None without one.
    busy
        Largest share of seconds, of all graphs, in which the machine was too busy for them.

    """

    def __init__(
        self, tasks: Mapping[str, Sequence[Task]], seed: int, out: Path, *,
        on_progress: OnProgress = lambda done, total: None,
    ) -> None:
        self.rows: list[FaultRow] = []
        self.interrupted: int | None = None
        self.busy = 0.0
        self._tasks, self._seed, self._out = tasks, seed, out
        self._on_progress = on_progress
        self._received: list[int] = []

    @property
    def total(self) -> int:
        """How many faults there are."""
        return sum(map(len, self._tasks.values())) + len(self._tasks)

    def run(self) -> list[FaultRow]:
        """
        Run all faults; SIGINT and SIGTERM end it early and cleanly.

        Returns
        -------
        list of FaultRow
            By kind; a graph that does not even come up has one, too.

        """
        with reserve_domain() as domain_id, collected_signals() as self._received, (
                contextlib.suppress(_InterruptedError)):
            for plant, tasks in self._tasks.items():
                self._run_plant(plant, list(tasks), domain_id)
        self.interrupted = self._received[0] if self._received else None
        order = {fault: i for i, fault in enumerate(faults_of(GRAPH))}
        return sorted(self.rows, key=lambda row: (
            order.get((row.kind, row.input), len(order)), row.plant, row.seed))

    def _run_plant(self, plant: str, tasks: list[Task], domain_id: int) -> None:
        """Run the faults of a plant, in a new graph after everything that was not safe."""
        setup = resolve(SCENARIO, plant=plant, seed=self._seed)
        failures = 0
        while failures < MAX_FAILURES:
            try:
                with FaultSession(
                        setup, self._new_folder(plant), domain_id, self._keep_waiting) as session:
                    failures = 0
                    if self._run_in(session, tasks):
                        self._add(_unwatched('ended', session.end_all(), plant, self._seed))
                        return
            except RunError as error:
                failures += 1
                self._add(_unwatched(
                    'started', [str(error).splitlines()[0]], plant, self._seed))
        for fault, seed in tasks:
            self._add(_unwatched(fault.kind, [NOT_RUN], plant, seed, fault.input))

    def _run_in(self, session: FaultSession, tasks: list[Task]) -> bool:
        """Run the faults until none is left; return False if one was not safe."""
        while tasks:
            row = break_once(session, *tasks.pop(0))
            self._add(row)
            self.busy = max(self.busy, busy_share(
                session.watch.reports, session.setup.controller.period))
            if not row.safe:
                return False
        return True

    def _keep_waiting(self) -> None:
        if self._received:
            raise _InterruptedError

    def _add(self, row: FaultRow) -> None:
        self.rows.append(row)
        self._on_progress(len(self.rows), self.total)

    def _new_folder(self, plant: str) -> Path:
        """Make the folder of a graph; none that is there is touched."""
        number = 1
        while (folder := self._out / FOLDER / file_name(f'{number:03d}-{plant}')).exists():
            number += 1
        folder.mkdir(parents=True)
        return folder


def break_once(session: FaultSession, fault: Fault, seed: int) -> FaultRow:
    """Let one fault happen, bring the graph back, and judge it."""
    random = fault.random(seed)
    problems, begin, before = [], time.time(), ' before the fault'
    end, recovered = begin, -1.0
    try:
        session.spin(float(random.uniform(*QUIET)))
        begin, before = time.time(), ''
        session.inject(fault, random, seed)
        end = time.time()
        session.recover()
        recovered = time.time()
        session.wait_for_report(end, REPORT_TIMEOUT)
    except NodeEndedError as error:
        problems.append(f'{error.node_name} died{before}')
    except RunError as error:
        problems.append(str(error).splitlines()[0] + before)
    seen = observe(session.watch, session.setup, session.wanted,
                   Window(begin, max(begin, end), recovered), problems)
    return judge(fault, seed, session.setup, seen, where=GRAPH)


def _unwatched(
    kind: str, problems: list[str], plant: str, seed: int, source: str = GRAPH,
) -> FaultRow:
    """Return a row about the start or the end of a graph, or about a fault that was not run."""
    return FaultRow(
        kind=kind, input=source, seed=seed, reaction='none', time_to_safe_s=0.0,
        peak_force_n=0.0, peak_torque_fraction=0.0, safe=not problems, plant=plant, phase='',
        problems=', '.join(problems), where=GRAPH)


def run_graph_campaign(
    plants: Sequence[str], seed: int, out: Path, *, quick: bool = False,
    console: Console | None = None,
) -> tuple[list[FaultRow], int | None]:
    """
    Run the campaign over the graph with a bar that says how long it will take.

    Parameters
    ----------
    plants, seed, quick
        As for `graph_tasks`.
    out
        Folder; every graph gets one of its own in it.
    console
        Where the bar is shown.

    Returns
    -------
    tuple
        The rows, and the signal that ended it early, if one did.

    """
    with count_bar(console) as progress:
        task = progress.add_task('faults over the graph')
        campaign = GraphCampaign(
            graph_tasks(plants, seed, quick=quick), seed, out,
            on_progress=lambda done, total: progress.update(task, completed=done, total=total))
        progress.update(task, total=campaign.total)
        rows = campaign.run()
        if campaign.busy > BUSY:
            progress.console.print(
                f'the machine was too busy for the graph in {100.0 * campaign.busy:.0f} % of the '
                'time: reactions to that are mixed in', highlight=False)
    return rows, campaign.interrupted
