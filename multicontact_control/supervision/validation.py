"""Which inputs are valid: ages, shapes, numbers, repetitions, jumps."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compile_for
from multicontact_control.config import ControllerConfig
from multicontact_control.records import (
    JOINT_READING,
    Records,
    VARIANCE_READING,
    WATCH,
)
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
from multicontact_control.supervision.readings import (
    ABSENT,
    check_inputs,
    FINE,
    INVALID,
    JOINTS,
    VARIANCE_CEILING,
    VARIANCE_FLOOR,
    WRENCH,
)
import numpy as np

__all__ = [
    'JointInput', 'TickInputs', 'ValidatedInputs', 'VarianceInput', 'Watchdog', 'WrenchInput']

Places = tuple[Matrix, Vector, Vector, Vector]
FLOAT = np.dtype(float)
INPUTS = ('joints', 'wrench', 'variance')
# Names of what `readings` counts.
PROBLEMS = ('', 'invalid', 'implausible', 'jump', 'frozen', 'saturated', 'stamp', 'order', 'late')
CLOCK = ('', 'invalid', 'backwards', 'rate', 'frozen')


class ValidatedInputs(NamedTuple):
    """
    The valid ones among the inputs of a tick.

    Attributes
    ----------
    q, qd, wrench
        The newest that were valid, None if there never were any. These arrays and R are
        overwritten by the next tick.
    variance
        R, inflated if it is not renewed, shape (r,) [N^2].
    causes
        What calls for a reaction.
    rejected
        What was wrong with readings in this tick, whether it calls for a reaction yet or not.
    repeated
        Whether this is the tick before once more.
    blind
        Whether the joint state is not that of this tick or the one before.
    measured
        Whether the wrench is of this tick.

    """

    q: Vector | None
    qd: Vector | None
    wrench: Vector | None
    variance: Vector
    causes: tuple[str, ...]
    rejected: tuple[str, ...]
    repeated: bool = False
    blind: bool = False
    measured: bool = True


def as_vector(values: Any, like: Vector) -> Vector | None:
    """Return values, whatever they are, as one array of numbers like another; None if not so."""
    if type(values) is np.ndarray and values.dtype is FLOAT and (
            values.shape == like.shape and values.flags.carray):  # numba compiles for each layout
        return values
    try:
        vector: Vector = np.array(values, dtype=float, order='C')
    except (TypeError, ValueError, OverflowError):
        return None
    return vector if vector.shape == like.shape else None


def as_number(value: Any) -> float:
    """Return a number, NaN if it is not one."""
    if type(value) is float:
        return value
    number = finite_number(value)
    return math.nan if number is None else number


def finite_number(value: Any) -> float | None:
    """Return a finite number, None if it is not one."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


class Watchdog:
    """
    Validates the inputs of every tick.

    A reading that is not valid counts as not received: the last valid one is used until it is
    older than its limit, and calls for a reaction then. Sizes are looked at here, times and
    numbers in `readings`, compiled.

    Parameters
    ----------
    config
        Limits, ages.
    places
        Where what is valid goes: q and v, shape (2, n), wrench, shape (6,), and R, shape (r,); and
        the torques that came with the joints, shape (n,); its own if not given.

    """

    def __init__(self, config: ControllerConfig, places: Places | None = None) -> None:
        n, r = len(config.robot.joint_names), len(config.columns)
        self._joints: Any = np.zeros(n, dtype=JOINT_READING)
        self._joints['speed_limit'] = config.limits.joint_speed or np.inf
        self._variances: Any = np.zeros(r, dtype=VARIANCE_READING)
        self._initial_variance = min(
            max(config.initial_noise_variance, VARIANCE_FLOOR), VARIANCE_CEILING)
        self._watch = watch_record(config)
        places = places or (np.zeros((2, n)), np.zeros(6), np.zeros(r), np.zeros(n))
        self._arguments = self._watch, self._joints, self._variances, places
        # What stands for numbers that have not come; what has is like it.
        self._no_joints, self._no_wrench, self._no_variance = (
            np.zeros(count) for count in (n, 6, r))
        # Views of what every tick looks at: looking up a field takes long.
        self._acted: Mask = self._watch['verdict']['acted']
        self._valid_stamps: Vector = self._watch['memory']['valid'][0]
        q, qd = places[0]
        self._all_well = ValidatedInputs(q, qd, places[1], places[2], (), ())
        compile_for(
            check_inputs, *self._arguments, 0.0, self._take_joints(None),
            _take(None, self._no_wrench), _take(None, self._no_variance))
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next tick is the first."""
        memory: Any = self._watch['memory']
        memory[:] = np.zeros_like(memory)
        for name in ('time', 'seen', 'valid'):
            memory[name] = math.nan
        memory['inflation'] = 1.0
        self._variances['valid'] = self._variances['used'] = self._initial_variance

    @property
    def joint_stamp(self) -> float:
        """Return the stamp of the newest valid joint state, NaN if there was none [s]."""
        return float(self._valid_stamps[JOINTS])

    @property
    def acted(self) -> bool:
        """Whether torques came with the newest joint state that say anything."""
        return bool(self._acted[0])

    def validate(self, inputs: TickInputs) -> ValidatedInputs:
        """Take in what is known at a tick and say what of it is valid."""
        time, joints, wrench, variance, _ = inputs
        return self._all_well if check_inputs(
            *self._arguments, as_number(time), self._take_joints(joints),
            _take(wrench, self._no_wrench), _take(variance, self._no_variance),
        ) else self._report()

    def _take_joints(
        self, reading: JointInput | None,
    ) -> tuple[float, int, Vector, Vector, bool, Vector]:
        """Return stamp, what is wrong with it so far, q, v, whether there is an effort, which."""
        nothing = self._no_joints
        if reading is None:
            return math.nan, ABSENT, nothing, nothing, False, nothing
        q, qd = as_vector(reading.q, nothing), as_vector(reading.qd, nothing)
        effort = None if reading.effort is None else as_vector(reading.effort, nothing)
        return (as_number(reading.stamp), INVALID if q is None or qd is None else FINE,
                nothing if q is None else q, nothing if qd is None else qd, effort is not None,
                nothing if effort is None else effort)

    def _report(self) -> ValidatedInputs:
        """Return what is valid of a tick in which not all is well."""
        verdict, memory = self._watch['verdict'][0], self._watch['memory'][0]
        newest = self._all_well
        joints_known = memory['joints_known']
        valid = ValidatedInputs(
            newest.q if joints_known else None, newest.qd if joints_known else None,
            newest.wrench if memory['wrench_known'] else None, newest.variance, (), (),
            bool(verdict['repeated']), bool(verdict['blind']),
            bool(verdict['problem'][WRENCH] == FINE))
        if valid.repeated:
            return valid._replace(blind=False)
        problems = [PROBLEMS[max(number, FINE)] for number in verdict['problem'].tolist()]
        causes = [f'clock_{CLOCK[verdict["clock"]]}'] if verdict['clock'] else []
        for key, problem, stale in zip(INPUTS, problems, verdict['stale']):
            if stale:
                causes.append(f"{key}_{problem or 'stale'}")
        return valid._replace(causes=tuple(causes), rejected=tuple(
            f'{key}_{problem}' for key, problem in zip(INPUTS, problems) if problem))


def _take(
    reading: WrenchInput | VarianceInput | None, nothing: Vector,
) -> tuple[float, int, Vector]:
    """Return stamp, what is wrong with it so far, and numbers of another reading."""
    if reading is None:
        return math.nan, ABSENT, nothing
    numbers = as_vector(reading[1], nothing)
    if numbers is None:
        return as_number(reading[0]), INVALID, nothing
    return as_number(reading[0]), FINE, numbers


def watch_record(config: ControllerConfig) -> Records:
    """Return what readings must be like in one record of `WATCH`, the rest of it empty."""
    watch, h = config.watchdog, config.period
    record = np.zeros(1, dtype=WATCH)
    record['wrench']['full_scale'] = 0.999 * np.array(watch.wrench_full_scale or np.inf)
    settings = record['settings']
    for name in ('position_jump', 'frozen_samples', 'frozen_joint_samples'):
        settings[name] = getattr(watch, name)
    settings['period'] = h
    settings['shortest'], settings['longest'] = h / watch.rate_band, h * watch.rate_band
    settings['max_age'] = h * (1e-3 + np.array(
        [watch.joint_max_age, watch.wrench_max_age, watch.variance_max_age]))
    settings['recovery_samples'] = round(watch.recovery_time * config.rate)
    return record
