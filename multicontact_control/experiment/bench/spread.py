"""Percentiles, spread between repeats, and whether a machine was quiet enough to believe them."""

from __future__ import annotations

from collections.abc import Sequence
import os
import platform
from typing import Any

from multicontact_control.arrays import Vector
import numpy as np

NOISY_TAIL = 2.0  # p99 of a floor over its p50
NOISY_SPREAD = 0.15  # of a floor's p50 between repeats


def percentiles(microseconds: Vector) -> dict[str, float]:
    """Return median, tails and maximum, rounded to nanoseconds."""
    p50, p99, p999 = np.percentile(microseconds, (50.0, 99.0, 99.9))
    return {'p50': round(float(p50), 3), 'p99': round(float(p99), 3),
            'p999': round(float(p999), 3), 'max': round(float(microseconds.max()), 3)}


def spread(values: Sequence[float]) -> float:
    """Return (max - min) / median."""
    middle = float(np.median(values))
    return round((max(values) - min(values)) / middle, 4) if middle else 0.0


def median(values: Sequence[float], digits: int = 3) -> float:
    """Return the median, rounded."""
    return round(float(np.median(values)), digits)


def noise_notes(floors: Sequence[Vector]) -> list[str]:
    """
    Say what speaks against believing a measurement.

    Parameters
    ----------
    floors
        Times of something that always does the same, one series per repeat.

    Returns
    -------
    list of str
        One line per reason; empty for a quiet machine.

    """
    notes = []
    tail = float(np.median([np.percentile(x, 99.0) / np.median(x) for x in floors]))
    if tail > NOISY_TAIL:
        notes.append(f"too noisy to trust: the floor's p99 is {tail:.1f} times its p50")
    between = spread([float(np.median(x)) for x in floors])
    if between > NOISY_SPREAD:
        notes.append(
            f"too noisy to trust: the floor's p50 varies by {between:.0%} between repeats")
    return notes


def load_notes(load: float | None, cores: int | None) -> list[str]:
    """Say whether something else was running, too."""
    if load is None or cores is None or load <= cores:
        return []
    return [f'too noisy to trust: a load of {load:.1f} on {cores} cores']


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
