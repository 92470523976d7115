"""Times of something and of its floor, and whether a machine was quiet enough to believe them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, ExitStack, suppress
import os
import platform
from time import perf_counter_ns
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.experiment.metrics import percentiles
import numpy as np
import psutil

NOISY_TAIL = 2.0  # p99 of a floor over its p50
NOISY_SPREAD = 0.15  # of a floor's p50 between repeats
NOISY_SHARE = 0.1  # of all cores' time that others take meanwhile
TOO_NOISY = 'too noisy to trust'


def race(
    work: Callable[[int], object], floor: Callable[[int], object], count: int, *,
    restart: Callable[[], object], lap: int,
) -> tuple[Vector, Vector]:
    """
    Time something and its floor right after each call of it, so that both see the same machine.

    Both are called `count` times with their place in a `lap`, before which comes `restart`,
    untimed. Returns the times of either, shape (count,) [us].
    """
    times, floors = np.zeros(count), np.zeros(count)
    for k in range(count):
        place = k % lap
        if place == 0:
            restart()
        start = perf_counter_ns()
        work(place)
        done = perf_counter_ns()
        floor(place)
        end = perf_counter_ns()
        times[k], floors[k] = done - start, end - done
    return 1e-3 * times, 1e-3 * floors


@contextmanager
def stopwatch(
    places: Sequence[tuple[Any, str, str]],
) -> Iterator[dict[tuple[str, str], list[float]]]:
    """
    Yield what the calls of some functions take [us], by stage and name, as they are made.

    Of each of these `places` the module or class is given, its name there, and its stage.
    """
    spent: dict[tuple[str, str], list[float]] = {}

    def timed(stage: str, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        taken = spent.setdefault((stage, name), [])

        def call(*arguments: Any) -> Any:
            start = perf_counter_ns()
            result = function(*arguments)
            taken.append(1e-3 * (perf_counter_ns() - start))
            return result
        return call

    with ExitStack() as stack:
        for owner, name, stage in places:
            function = getattr(owner, name)
            stack.callback(setattr, owner, name, function)
            setattr(owner, name, timed(stage, name, function))
        yield spent


def rounded_percentiles(microseconds: Vector) -> dict[str, float]:
    """Return median, tails and maximum, rounded to nanoseconds."""
    return {name: round(value, 3) for name, value in percentiles(microseconds).items()}


def spread(values: Sequence[float]) -> float:
    """Return (max - min) / median."""
    middle = float(np.median(values))
    return round((max(values) - min(values)) / middle, 4) if middle else 0.0


def median(values: Sequence[float], digits: int = 3) -> float:
    """Return the median, rounded."""
    return round(float(np.median(values)), digits)


def noise_notes(floors: Sequence[Vector]) -> list[str]:
    """Say what speaks against believing a measurement, from the floor's times in each repeat."""
    notes = []
    tail = float(np.median([np.percentile(x, 99.0) / np.median(x) for x in floors]))
    if tail > NOISY_TAIL:
        notes.append(f"{TOO_NOISY}: the floor's p99 is {tail:.1f} times its p50")
    between = spread([float(np.median(x)) for x in floors])
    if between > NOISY_SPREAD:
        notes.append(
            f"{TOO_NOISY}: the floor's p50 varies by {between:.0%} between repeats")
    return notes


class Bystanders:
    """What others take of the machine while this process and its children work, on Linux."""

    def __init__(self) -> None:
        self._start = _processor_time()

    def share(self) -> float | None:
        """Return the share of all cores' time they took so far, None where nothing tells."""
        now = _processor_time()
        if now is None or self._start is None:
            return None
        total, idle, own = (after - before for before, after in zip(self._start, now))
        return round(max(0.0, total - idle - own) / total, 4) if total > 0.0 else None


def _processor_time() -> tuple[float, float, float] | None:
    """Return the time of all cores [s], how much of it was idle, how much was ours."""
    try:
        with open('/proc/stat', encoding='utf-8') as file:
            # user nice system idle iowait irq softirq steal; guests are in user and nice
            ticks = [int(field) for field in file.readline().split()[1:9]]
    except OSError:
        return None
    frequency = os.sysconf('SC_CLK_TCK')
    return sum(ticks) / frequency, (ticks[3] + ticks[4]) / frequency, _own_time()


def _own_time() -> float:
    """Return what this process and all that come from it took, and those they waited for [s]."""
    this, own = psutil.Process(), 0.0
    for process in (this, *this.children(recursive=True)):
        with suppress(psutil.NoSuchProcess):
            own += sum(process.cpu_times()[:4])
    return own


def share_notes(share: float | None) -> list[str]:
    """Say whether others took more of the machine than one can ignore."""
    if share is None or share <= NOISY_SHARE:
        return []
    return [f"{TOO_NOISY}: others took {share:.0%} of all cores' time meanwhile"]


def describe_machine() -> dict[str, Any]:
    """Return what the numbers depend on."""
    load = os.getloadavg()[0] if hasattr(os, 'getloadavg') else None
    return {
        'processor': _processor(), 'cores': os.cpu_count(), 'load_1min': load,
        'system': f'{platform.system()} {platform.release()}',
        'python': platform.python_version()}


def _processor() -> str:
    try:
        with open('/proc/cpuinfo', encoding='utf-8') as file:
            for line in file:
                if line.startswith('model name'):
                    return line.split(':', 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
