"""How long a matrix of runs will take."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
import time

from multicontact_control.experiment.engine import CellStore, RunCell

START_UP = 3.0  # s, to start a pool of workers
PROBE = 1.5  # s of simulated time that a plant's speed is taken from


@dataclass(frozen=True)
class Estimate:
    """
    What is to be done.

    Attributes
    ----------
    runs, finished
        All runs, and those that are finished already.
    seconds
        Wall time that the others will take [s]; None if that is not known.

    """

    runs: int
    finished: int
    seconds: float | None

    @property
    def todo(self) -> int:
        """Return how many runs are not finished."""
        return self.runs - self.finished

    def sentence(self, jobs: int) -> str:
        """Return all this in words."""
        known = f'{self.runs} runs, {self.finished} of them finished before'
        if self.seconds is None or not self.todo:
            return f'{known}; {jobs} at once'
        return (f'{known}; the other {self.todo} will take about {_words(self.seconds)} with '
                f'{jobs} at once')


def estimate_time(
    cells: Iterable[RunCell], folder: Path, jobs: int, *, probe: bool = True,
) -> Estimate:
    """
    Return how long the cells that are not finished will take.

    From the finished cells of the same plant, or from a short run of it.

    Parameters
    ----------
    cells
        The matrix; a cell may come twice.
    folder
        Where finished cells are.
    jobs
        How many run at once.
    probe
        Whether to make short runs where nothing is finished.

    """
    store = CellStore(folder)
    known: dict[str, list[float]] = {}  # wall time for a simulated second, by plant
    todo: dict[str, list[float]] = {}  # simulated seconds
    examples: dict[str, RunCell] = {}
    keyed = {cell.key(): cell for cell in cells}
    for key, cell in keyed.items():
        result, duration = store.load(key), cell.setup().scenario.duration
        if result is None:
            todo.setdefault(cell.plant, []).append(duration)
            examples.setdefault(cell.plant, cell)
        else:
            known.setdefault(cell.plant, []).append(result.wall_time / duration)
    left = sum(map(len, todo.values()))
    if not probe and not todo.keys() <= known.keys():
        return Estimate(len(keyed), len(keyed) - left, None)
    total = sum(
        sum(durations) * (median(known[plant]) if plant in known else _probe(examples[plant]))
        for plant, durations in todo.items())
    start_up = START_UP if left > 1 and jobs > 1 else 0.0
    return Estimate(len(keyed), len(keyed) - left, total / min(jobs, max(left, 1)) + start_up)


def _probe(cell: RunCell) -> float:
    """Return the wall time for a simulated second of a cell, from its beginning."""
    # Only here: who needs no probe needs neither kernels nor simulator.
    from multicontact_control.experiment.compilation import ensure_compiled
    from multicontact_control.experiment.loop import run_in_process

    ensure_compiled()
    setup = cell.setup()
    duration = min(PROBE, setup.scenario.duration)
    short = replace(setup, scenario=setup.scenario.model_copy(update={'duration': duration}))
    try:
        run_in_process(short, supervised=cell.supervised)
        start = time.perf_counter()
        run_in_process(short, supervised=cell.supervised)
    except Exception:  # whatever ails this cell comes out when it is run
        return 0.0
    return (time.perf_counter() - start) / duration


def _words(seconds: float) -> str:
    if seconds < 90.0:
        return f'{seconds:.0f} s'
    if seconds < 5400.0:
        return f'{seconds / 60.0:.1f} min'
    return f'{seconds / 3600.0:.1f} h'
