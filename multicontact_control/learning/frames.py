"""The frames of a recording: at each the newest sample, and all samples since the frame before."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from multicontact_control.arrays import find_true_stretches, Mask, Matrix
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.judging.results import LoadedRun
from multicontact_control.judging.supervisor_events import read_event
from multicontact_control.runs.recording import (
    hold_until_next,
    LONGEST_GAP,
    OF_JOINTS,
    RunData,
    WIDTHS,
)
from multicontact_control.supervision.contacts import STATE_NAMES
import numpy as np
from numpy.typing import NDArray

# The series that each feature is made of, side by side: of the newest sample of a frame.
OF_FRAME = {
    'observation.state': ('q', 'position', 'quaternion'),
    'observation.velocity': ('qd',),
    'observation.effort': ('effort',),
    'observation.wrench': ('wrench',),
    'observation.force': ('alpha_meas',),
    'observation.force_estimated': ('alpha_est',),
    'observation.force_desired': ('alpha_des',),
    'observation.force_variance': ('noise_variance',),
    'observation.stiffness': ('stiffness',),
    # Beside `state` the only numbers that most policies of LeRobot take.
    'observation.environment_state': ('alpha_meas', 'alpha_est', 'noise_variance'),
    'action': ('position_des', 'quaternion_des', 'alpha_des'),
}
# And of every sample of its window, sample by sample in one row: LeRobot's tools that edit a
# dataset know no matrices. No name begins with `observation`, by which its policies take their
# inputs.
OF_WINDOW = {
    'window.wrench': 'wrench',
    'window.force': 'alpha_meas',
    'window.force_estimated': 'alpha_est',
    'window.force_desired': 'alpha_des',
    'window.force_variance': 'noise_variance',
}
REQUIRED = ('observation.state', 'observation.force', 'action')
CONTACT_STATE = 'observation.contact_state'
STAMP = 'recording.stamp'
WINDOW_TIME = 'window.time'
AXES_BY_WIDTH = {
    3: ('x', 'y', 'z'),
    4: ('qx', 'qy', 'qz', 'qw'),
    6: ('fx', 'fy', 'fz', 'tx', 'ty', 'tz'),
}
# What a series of contacts is called before the name of each contact.
OF_CONTACTS = {
    'alpha_meas': 'force',
    'alpha_est': 'force_estimated',
    'alpha_des': 'force_desired',
    'noise_variance': 'force_variance',
    'stiffness': 'stiffness',
}
UNKNOWN_STATE = -1


class Feature(NamedTuple):
    """A column of a dataset: what each frame has of it."""

    dtype: str  # of numpy
    shape: tuple[int]  # of one frame
    names: tuple[str, ...] | None  # of the entries

    def describe(self) -> dict[str, Any]:
        """Return the entry of the feature in ``info.json``."""
        return self._asdict()


class Frames(NamedTuple):
    """
    The frames of one stretch of a recording in which no sample is missing for longer than 0.1 s.

    Values have a row for each of the f frames, shape (f, k) with the k entries of the feature.
    """

    features: dict[str, Feature]
    values: dict[str, NDArray[Any]]


class SampleSeries:
    """
    The samples of a recording that have everything which the recording has at all.

    Parameters
    ----------
    run
        A run of this package, or a recording with its topics.

    Attributes
    ----------
    left_out
        Features that the recording lacks.
    complete
        Whether each sample has a number in every series, shape (m,).

    Raises
    ------
    RunError
        If it lacks the pose, the measured forces, or the desired ones.

    """

    def __init__(self, run: LoadedRun) -> None:
        self._run = run
        self._data = run.data
        self._series = _find_series(run)
        self.left_out: list[str] = []
        used: set[str] = set()
        for feature, names in OF_FRAME.items():
            if all(name in self._series for name in names):
                used.update(names)
            else:
                self.left_out.append(feature)
        lacking = [feature for feature in REQUIRED if feature in self.left_out]
        if lacking:
            raise RunError(
                f'{run.folder}: expected joint positions, poses and contact forces, '
                f'measured and desired; nothing is there for {", ".join(lacking)}'
            )
        self.complete: Mask = np.ones(self._data.ticks, dtype=bool)
        for name in used:
            self.complete &= np.isfinite(self._series[name]).all(axis=1)
        self._stamps = _find_stamps(run)
        self._states = _find_contact_states(run)

    def cut_frames(self, fps: int) -> list[Frames]:
        """
        Return the frames at a rate [Hz], one set for each stretch without a gap.

        A frame lies at the end of each period of 1 / fps. It has the newest sample until then, and
        a window of as many samples as belong into that period: without a loss each sample is in
        one window; where one is missing an earlier one stands in its place.

        Raises
        ------
        ConfigError
            If no whole number of samples makes a frame, or the samples make no frame.

        """
        window = count_samples_per_frame(self._data.rate, fps)
        sets = []
        for begin, end in self._find_stretches():
            known = begin + np.flatnonzero(self.complete[begin:end])
            frame_rows = np.arange(begin + window - 1, end, window)
            newest = np.searchsorted(known, frame_rows, side='right') - 1
            newest = newest[newest >= window - 1]
            if newest.size:
                before = np.arange(1 - window, 1)
                sets.append(self._read_frames(known[newest[:, None] + before]))
        if not sets:
            raise ConfigError(
                'run',
                f'{window} complete samples or more, which make a frame',
                f'{int(self.complete.sum())} in {self._run.folder}',
            )
        return sets

    def _find_stretches(self) -> list[tuple[int, int]]:
        """Return the rows from first to behind last of what lies between long gaps."""
        bridged = self.complete.copy()
        for begin, end in find_true_stretches(~self.complete):
            if end - begin <= LONGEST_GAP * self._data.rate:
                bridged[begin:end] = True
        stretches = []
        for begin, end in find_true_stretches(bridged):
            first = begin + int(np.argmax(self.complete[begin:end]))
            stretches.append((first, end))
        return stretches

    def _read_frames(self, rows: NDArray[np.int64]) -> Frames:
        """Return frames whose windows are these samples, shape (f, window), oldest first."""
        newest = rows[:, -1]
        stamps = self._stamps[newest]
        frames = Frames({}, {})
        for feature, names in OF_FRAME.items():
            if feature not in self.left_out:
                values = [self._series[name][newest] for name in names]
                labels = [label for name in names for label in self._label(name)]
                _add_feature(frames, feature, np.hstack(values), labels)
        states = self._states[newest]
        _add_feature(
            frames, CONTACT_STATE, states, self._run.setup.controller.contact_names
        )
        for feature, name in OF_WINDOW.items():
            if name in self._series:
                samples = self._series[name][rows].reshape(len(rows), -1)
                window = _label_window(self._label(name), rows.shape[1])
                _add_feature(frames, feature, samples, window)
        before = (self._stamps[rows] - stamps[:, None]) * 1e-9
        _add_feature(frames, WINDOW_TIME, before)
        _add_feature(frames, STAMP, stamps[:, None])
        return frames

    def _label(self, series: str) -> Sequence[str]:
        """Return the names of the columns of a series."""
        if series in OF_JOINTS:
            return self._data.joint_names
        if series in WIDTHS:
            return AXES_BY_WIDTH[WIDTHS[series]]
        kind = OF_CONTACTS[series]
        return [f'{kind}.{name}' for name in self._data.contact_names]


def _add_feature(
    frames: Frames,
    name: str,
    values: NDArray[Any],
    labels: Sequence[str] | None = None,
) -> None:
    """Add a feature; numbers that are not whole are rounded to float32, as LeRobot reads them."""
    if values.dtype == np.float64:
        values = values.astype(np.float32)
    names = None
    if labels is not None:
        names = tuple(labels)
    frames.features[name] = Feature(values.dtype.name, (values.shape[1],), names)
    frames.values[name] = values


def _label_window(labels: Sequence[str], window: int) -> list[str]:
    """Return the names of a window's entries: ``@0`` is the newest sample, ``@-1`` that before."""
    names = []
    for age in reversed(range(window)):
        names += [f'{label}@{-age}' for label in labels]
    return names


def count_samples_per_frame(rate: float, fps: int) -> int:
    """
    Return how many samples at a rate make a frame at another [Hz].

    Raises ConfigError of `rate` unless it is a whole number.
    """
    samples = round(rate / fps)
    if samples < 1 or samples * fps != rate:
        whole = [n for n in range(1, int(rate) + 1) if (rate / n).is_integer()]
        raise ConfigError(
            'rate',
            f'a whole part of the {rate:g} Hz of the recording: '
            f'{", ".join(map(str, whole)) or "none is"}',
            fps,
        )
    return samples


def _find_series(run: LoadedRun) -> dict[str, Matrix]:
    """Return the series that a recording has in all their columns, by name."""
    found = {}
    for name in {name for names in OF_FRAME.values() for name in names}:
        values = getattr(run.data, name)
        if np.isfinite(values).any(axis=0).all():
            found[name] = values
    config = run.setup.controller
    if 'stiffness' not in found and config.robot.urdf:
        configured = [column.stiffness for column in config.columns]
        found['stiffness'] = np.tile(configured, (run.data.ticks, 1))
    return found


def _find_stamps(run: LoadedRun) -> NDArray[np.int64]:
    """Return the stamps of the samples [ns], shape (m,); those of a run in process begin at 0."""
    if run.content is not None:
        return run.content.stamps
    return np.rint(run.data.time * 1e9).astype(np.int64)


def _find_contact_states(run: LoadedRun) -> NDArray[np.int64]:
    """
    Return the states of the contacts as indices of `STATE_NAMES`, shape (m, c).

    They are those of the supervisor's log, or of a recording without one those that ``~/status``
    told; -1 where nothing tells them.
    """
    names = run.setup.controller.contact_names
    log = run.summary.get('events') or ()
    if run.content is not None and not log:
        states = run.content.contact_states
    else:
        states = _read_states_of_log(log, run.data, len(names))
    return np.where(np.isnan(states), UNKNOWN_STATE, states).astype(np.int64)


def _read_states_of_log(
    log: Sequence[dict[str, Any]], data: RunData, contacts: int
) -> Matrix:
    """Return the states that the events of ``summary.json`` tell, shape (m, c), NaN for none."""
    states = np.full((data.ticks, contacts), np.nan)
    if not log:
        return states
    begins = []
    told = []
    for line in log:
        event = read_event(line['time_s'], line['what'])
        begins.append(round(event.time * data.rate))
        told.append([STATE_NAMES.index(state) for state in event.contact_states])
    rows = np.minimum(begins, data.ticks)
    for column, values in enumerate(np.array(told, dtype=float).T):
        states[:, column] = hold_until_next(data.ticks, rows, values)
    return states
