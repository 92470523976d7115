"""The series of a run, sample by sample, and how they are read from a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
import hashlib
import math
from pathlib import Path
from typing import Any, NamedTuple
import zipfile

from multicontact_control.arrays import Mask, Matrix, stretches, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.config.contact import ACROSS, ALONG, SUFFIXES
from multicontact_control.errors import RunError
from multicontact_control.runs import bag
import numpy as np
from numpy.typing import NDArray

SERIES_FILE = 'samples.npz'
OF_STIFFNESS = ('stiffness', 'stiffness_est', 'stiffness_std', 'margin')
# Which field of the messages of a topic a series is.
SERIES: dict[str, dict[str, str]] = {
    'joint_states': {'q': 'position', 'qd': 'velocity', 'effort': 'effort'},
    'ft_sensor/wrench': {'wrench': 'wrench'},
    'ft_sensor/wrench_filtered': {'wrench_filtered': 'wrench'},
    'joint_effort_command': {'torque': 'effort'},
    'contact_forces/measured': {'alpha_meas': 'effort'},
    'contact_forces/estimated': {'alpha_est': 'effort', 'alpha_rate_est': 'velocity'},
    'contact_forces/desired': {'alpha_des': 'effort'},
    'contact_forces/innovation': {'innovation': 'effort'},
    'contact_forces/stiffness': {
        'stiffness_est': 'position',
        'stiffness_std': 'velocity',
        'stiffness': 'effort',
    },
    'contact_forces/stability_margin': {'margin': 'effort'},
    'contact_forces/noise_variance': {'noise_variance': 'effort'},
    'ground_truth/contact_forces': {'alpha_true': 'effort'},
    'operational_point/pose': {'position': 'point', 'quaternion': 'quaternion'},
    'operational_point/pose_desired': {
        'position_des': 'point',
        'quaternion_des': 'quaternion',
    },
}
# Published only where the stiffness is found on-line.
OPTIONAL = ('contact_forces/stiffness', 'contact_forces/stability_margin')
SAMPLES, MEASURED, OBEYED = (
    'joint_states',
    'contact_forces/measured',
    'controller_node/status',
)
TYPES = dict.fromkeys(SERIES, bag.JOINT_STATE) | {
    OBEYED: bag.STATUS,
    'ft_sensor/wrench': bag.WRENCH,
    'ft_sensor/wrench_filtered': bag.WRENCH,
    'operational_point/pose': bag.POSE,
    'operational_point/pose_desired': bag.POSE,
}
SPARSE = 20.0  # ticks per sample beyond which the stamps are no clock
CUT_OFF = 'the recording is cut off'
LONGEST_GAP = 0.1  # s without a sample, beyond which a recording lacks something
GAPS_NAMED = 3  # at most, in a line
REACHED = 0.99  # share of a commanded force at which the contact counts as made


@dataclass(frozen=True)
class RunData:
    """Every series of a run; row k belongs to sample k, NaN where a message is missing."""

    rate: float  # samples per second [Hz]
    contact_names: tuple[str, ...]  # order of the r columns of contacts
    joint_names: tuple[str, ...]  # and of the n columns of joints
    time: Vector  # since the first sample, shape (m,) [s]
    q: Matrix  # joint position, velocity, measured and commanded torque, shape (m, n)
    qd: Matrix
    effort: Matrix
    torque: Matrix
    wrench: Matrix  # of the wrist sensor, in its frame, shape (m, 6)
    wrench_filtered: Matrix
    alpha_true: Matrix  # contact forces, shape (m, r) [N]
    alpha_meas: Matrix
    alpha_est: Matrix
    alpha_rate_est: Matrix  # [N/s]
    alpha_des: Matrix
    noise_variance: (
        Matrix  # R from the samples up to k, used at k + 1, shape (m, r) [N^2]
    )
    # alpha_meas minus what the observers predicted, 0 where no force is controlled [N].
    innovation: Matrix
    # Of the observers' models, found on-line and its standard error, shape (m, r) [N/m], and how
    # many times as stiff a surface might be; NaN throughout where the stiffness is configured.
    stiffness: Matrix
    stiffness_est: Matrix
    stiffness_std: Matrix
    margin: Matrix
    # Forces commanded over topics, as accepted, shape (m, r) [N]: from when the contact was made
    # on, 0 where none is asked for; NaN of a run in process.
    command: Matrix
    position: Matrix  # operational point, world axes, shape (m, 3)
    quaternion: Matrix  # scalar last, shape (m, 4)
    position_des: Matrix
    quaternion_des: Matrix

    @property
    def ticks(self) -> int:
        """Return the number of samples."""
        return int(self.time.shape[0])

    def recorded(self) -> Mask:
        """Return the samples of which anything was recorded, shape (m,)."""
        known = np.zeros(self.ticks, dtype=bool)
        for name, values in vars(self).items():
            # Times are made, and commands hold until the next one.
            if isinstance(values, np.ndarray) and name not in ('time', 'command'):
                known |= np.isfinite(values).any(axis=1)
        return known

    def trajectory_sha256(self) -> str:
        """Return the hash of the commanded torques as little-endian float64, tick by tick."""
        return hashlib.sha256(
            np.ascontiguousarray(self.torque, dtype='<f8').tobytes()
        ).hexdigest()

    def part(self, begin: int, end: int) -> RunData:
        """Return the samples from one up to another; time begins with the first of them."""
        series: dict[str, Any] = {
            name: values[begin:end]
            for name, values in vars(self).items()
            if isinstance(values, np.ndarray)
        }
        return replace(self, **{**series, 'time': self.time[: end - begin]})

    def save(self, folder: Path) -> None:
        """Write the series to ``samples.npz`` in a folder."""
        np.savez_compressed(folder / SERIES_FILE, **vars(self))

    @classmethod
    def load(cls, folder: Path) -> RunData:
        """Read the series that `save` wrote; RunError if the file is missing or damaged."""
        path = folder / SERIES_FILE
        try:
            with np.load(path, allow_pickle=False) as data:
                values = {f.name: data[f.name] for f in fields(cls)}
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise RunError(
                f'{path}: expected a recording of a run, got {error}'
            ) from None
        return cls(
            **{
                **values,
                'rate': float(values['rate']),
                'contact_names': tuple(map(str, values['contact_names'])),
                'joint_names': tuple(map(str, values['joint_names'])),
            }
        )


def empty_run_data(ticks: int, controller: ControllerConfig) -> RunData:
    """Return series of NaN to be filled in, with the time axis set."""
    joints, contacts = controller.robot.joint_names, controller.column_names
    columns = {
        **dict.fromkeys(('q', 'qd', 'effort', 'torque'), len(joints)),
        **dict.fromkeys(('wrench', 'wrench_filtered'), 6),
        **dict.fromkeys(
            (
                'alpha_true',
                'alpha_meas',
                'alpha_est',
                'alpha_rate_est',
                'alpha_des',
                'noise_variance',
                'innovation',
                *OF_STIFFNESS,
                'command',
            ),
            len(contacts),
        ),
        **dict.fromkeys(('position', 'position_des'), 3),
        **dict.fromkeys(('quaternion', 'quaternion_des'), 4),
    }
    return RunData(
        rate=controller.rate,
        contact_names=contacts,
        joint_names=joints,
        time=np.arange(ticks) / controller.rate,
        **{name: np.full((ticks, count), np.nan) for name, count in columns.items()},
    )


class Missing(NamedTuple):
    """A stretch of a run of which no sample was recorded."""

    begin: float  # since the first sample that is there [s]; minus infinity: from an unknown one
    end: float  # s; infinite: to an unknown end

    def __str__(self) -> str:
        """Return from when to when."""
        if math.isinf(self.begin):
            return 'before the first one that is there'
        if math.isinf(self.end):
            return f'from {self.begin:.2f} s on'
        return f'from {self.begin:.2f} to {self.end:.2f} s'


def name_missing(missing: Sequence[Missing], what: str = 'samples') -> str:
    """Return in words from when to when something, by default the samples, is missing."""
    text = ', '.join(map(str, missing[:GAPS_NAMED]))
    if len(missing) > GAPS_NAMED:
        text += f' and {len(missing) - GAPS_NAMED} times more'
    return f'no {what} {text}'


def gaps_of(data: RunData) -> list[Missing]:
    """Return the stretches between samples in which more than 0.1 s were not recorded."""
    longest = LONGEST_GAP * data.rate
    return [
        Missing(begin / data.rate, end / data.rate)
        for begin, end in stretches(~data.recorded())
        if end - begin > longest
    ]


@dataclass(frozen=True)
class BagContent:
    """A bag read back."""

    data: RunData  # by sample stamp
    lacking: tuple[str, ...]  # topics of the controller that are not in the bag
    remarks: tuple[str, ...]  # what could not be read, and what is not there, in words
    start: int  # stamp of the first sample [ns]
    missing: tuple[Missing, ...]  # stretches without samples

    @property
    def unanswered(self) -> int:
        """Return the number of samples without a commanded torque."""
        silent = np.isnan(self.data.torque).all(axis=1)
        return int((silent & self.data.recorded()).sum())


def read_bag(
    path: Path,
    controller: ControllerConfig,
    *,
    namespace: str | None = None,
    answered: bool = False,
) -> BagContent:
    """
    Read a recording of the graph: a bag's folder, or its MCAP file, up to its last whole chunk.

    `controller` gives rate, contacts and joints; `namespace` is that of the graph, by default the
    only one; if `answered`, the samples before the first answer and behind the last are left out.
    There is a row for each sample of ``joint_states``, or else of the topic with most messages.
    Raises RunError if the bag cannot be read or holds no samples.
    """
    return content_of(path, read_graph(path, namespace), controller, answered=answered)


def read_graph(path: Path, namespace: str | None = None) -> bag.BagMessages:
    """Read the messages of a graph of this package; RunError if there are none."""
    messages = bag.read_messages(path, TYPES, namespace)
    if not any(topic in SERIES for topic in messages.by_topic):
        raise RunError(
            f'{path}: expected samples on joint_states, or another topic of the '
            f'controller, got {messages}'
        )
    return messages


def sample_topic(messages: bag.BagMessages) -> str:
    """Return the topic that has a message for every sample."""
    there = [topic for topic in SERIES if topic in messages.by_topic]
    return (
        SAMPLES
        if SAMPLES in there
        else max(there, key=lambda x: len(messages.by_topic[x]))
    )


def content_of(
    path: Path,
    messages: bag.BagMessages,
    controller: ControllerConfig,
    *,
    answered: bool = False,
) -> BagContent:
    """Return the series of the messages that `read_graph` found; see `read_bag`."""
    topic = sample_topic(messages)
    samples = messages.by_topic[topic]
    stamps, newest = np.unique(samples.stamps[::-1], return_index=True)
    ticks = np.rint((stamps - stamps[0]) * 1e-9 * controller.rate).astype(np.int64)
    count = int(ticks[-1]) + 1
    if count > SPARSE * len(stamps) + controller.rate or 2 * len(stamps) < len(samples):
        raise RunError(
            f'{path}: {topic}: expected stamps {1e3 * controller.period:g} ms apart, got '
            f'{len(samples)} messages with {len(stamps)} stamps over '
            f'{(int(stamps[-1]) - int(stamps[0])) * 1e-9:.3g} s'
        )
    data = empty_run_data(count, controller)
    for name, columns in messages.by_topic.items():
        names = (
            ()
            if TYPES[name] != bag.JOINT_STATE
            else (data.joint_names if name.startswith('joint') else data.contact_names)
        )
        places = np.searchsorted(stamps, columns.stamps).clip(max=len(stamps) - 1)
        known = stamps[places] == columns.stamps
        for series, field in SERIES.get(name, {}).items():
            getattr(data, series)[ticks[places[known]]] = columns.values(field, names)[
                known
            ]
    data = replace(
        data,
        command=_commands(
            data, messages.by_topic.get(OBEYED), samples.published[::-1][newest], ticks
        ),
    )
    begin, end = _answered(data) if answered else (0, count)
    part = data.part(begin, end)
    return BagContent(
        part,
        tuple(x for x in SERIES if x not in messages.by_topic and x not in OPTIONAL),
        _remarks(messages, data),
        int(stamps[0]) + round(begin / data.rate * 1e9),
        _missing(messages, part),
    )


def _missing(messages: bag.BagMessages, data: RunData) -> tuple[Missing, ...]:
    """Return the stretches without samples, also before the first and after the last one."""
    missing = gaps_of(data)
    if messages.loss.at_begin:
        missing.insert(0, Missing(-math.inf, 0.0))
    if messages.loss.at_end:
        missing.append(Missing(data.ticks / data.rate, math.inf))
    return tuple(missing)


def _answered(data: RunData) -> tuple[int, int]:
    """Return the first sample that was answered, and the one behind the last, if any was."""
    for series in (data.alpha_meas, data.torque):
        known = np.flatnonzero(np.isfinite(series).any(axis=1))
        if known.size:
            return int(known[0]), int(known[-1]) + 1
    return 0, data.ticks


def _commands(
    data: RunData,
    status: bag.BagColumns | None,
    published: NDArray[np.uint64],
    ticks: NDArray[np.int64],
) -> Matrix:
    """Return what `~/status` says is obeyed from contact on, else what the controller aims at."""
    command = data.alpha_des.copy()
    if status is None:
        return command
    order = np.argsort(published)
    places = np.searchsorted(published[order], status.published)
    begins = np.append(ticks[order], data.ticks)[places]
    for i, (name, forces) in enumerate(
        zip(data.contact_names, status.values('effort', data.contact_names).T)
    ):
        desired, named = data.alpha_des[:, i], ~np.isnan(forces)
        if not named.any() or name.endswith((SUFFIXES[ALONG], SUFFIXES[ACROSS])):
            continue
        begun = np.full(data.ticks + 1, np.nan)
        begun[0] = 0.0
        begun[begins[named]] = forces[named]
        newest = np.where(np.isnan(begun), 0, np.arange(data.ticks + 1))
        asked = begun[np.maximum.accumulate(newest)][:-1]
        for begin, end in stretches(asked > 0.0):
            reached = np.flatnonzero(desired[begin:end] >= REACHED * asked[begin:end])
            if reached.size:
                asked[begin : begin + reached[0]] = 0.0
        command[:, i] = asked
    return command


def _remarks(messages: bag.BagMessages, data: RunData) -> tuple[str, ...]:
    remarks = [*messages.unreadable, *messages.loss.words]
    for topic, values, expected in (
        (SAMPLES, data.q, data.joint_names),
        (MEASURED, data.alpha_meas, data.contact_names),
    ):
        if topic in messages.by_topic and expected and not np.isfinite(values).any():
            names = ', '.join(messages.by_topic[topic].names) or 'none'
            remarks.append(f'{topic}: expected {", ".join(expected)}, got {names}')
    if messages.cut_off:
        remarks.append(CUT_OFF)
    return tuple(remarks)
