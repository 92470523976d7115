"""The series of a run, sample by sample, and how they are read from a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
import hashlib
import math
from pathlib import Path
from typing import NamedTuple
import zipfile

from multicontact_control.arrays import find_true_stretches, Mask, Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.config.contact import ACROSS, ALONG, SUFFIXES
from multicontact_control.errors import RunError
from multicontact_control.runs import bag
import numpy as np
from numpy.typing import NDArray

SERIES_FILE = 'samples.npz'
SAMPLES = 'joint_states'
COMMANDS = 'joint_effort_command'
MEASURED = 'contact_forces/measured'
OBEYED = 'controller_node/status'
# The series that a topic has, and the field of its messages that each one is.
SERIES: dict[str, dict[str, str]] = {
    SAMPLES: {'q': 'position', 'qd': 'velocity', 'effort': 'effort'},
    'ft_sensor/wrench': {'wrench': 'wrench'},
    'ft_sensor/wrench_filtered': {'wrench_filtered': 'wrench'},
    COMMANDS: {'torque': 'effort'},
    MEASURED: {'alpha_meas': 'effort'},
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
TYPES = dict.fromkeys(SERIES, bag.JOINT_STATE) | {
    OBEYED: bag.STATUS,
    'ft_sensor/wrench': bag.WRENCH,
    'ft_sensor/wrench_filtered': bag.WRENCH,
    'operational_point/pose': bag.POSE,
    'operational_point/pose_desired': bag.POSE,
}
# Columns of the series that have none for each contact, nor for each joint.
WIDTHS = {
    'wrench': 6,
    'wrench_filtered': 6,
    'position': 3,
    'position_des': 3,
    'quaternion': 4,
    'quaternion_des': 4,
}
OF_JOINTS = ('q', 'qd', 'effort', 'torque')
SPARSE = 20.0  # ticks per sample beyond which the stamps are no clock
CUT_OFF = 'the recording is cut off'
LONGEST_GAP = 0.1  # s without a sample, beyond which a recording lacks something
GAPS_NAMED = 3  # at most, in a line
REACHED = 0.99  # share of a commanded force at which the contact counts as made


@dataclass(frozen=True)
class RunData:
    """
    Every series of a run; row k belongs to sample k, NaN where a message is missing.

    There are m rows, one for each control period, n joints and r forces and couples of contacts.
    Rows without a sample, as where a recording has a gap, are NaN throughout.
    """

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
    # R from the samples up to k, used at k + 1, shape (m, r) [N^2].
    noise_variance: Matrix
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
        """
        Return the number of samples m, those that are missing in between included.

        Rows are equally spaced in time by one control period.
        """
        return int(self.time.shape[0])

    def recorded(self) -> Mask:
        """
        Return the samples of which anything was recorded, shape (m,).

        A row without anything is a lost sample, whose numbers are all NaN; every statistic has to
        leave it out.
        """
        known = np.zeros(self.ticks, dtype=bool)
        for name, values in self._list_series().items():
            # Times are computed, and a command holds until the next one.
            if name not in ('time', 'command'):
                known |= np.isfinite(values).any(axis=1)
        return known

    def trajectory_sha256(self) -> str:
        """
        Return the hash of the commanded torques as little-endian float64, tick by tick.

        Two runs have the same hash if all their torques are the same bit for bit.
        """
        torques = np.ascontiguousarray(self.torque, dtype='<f8')
        return hashlib.sha256(torques.tobytes()).hexdigest()

    def part(self, begin: int, end: int) -> RunData:
        """
        Return the samples from one up to another; time begins with the first of them.

        `begin` and `end` are rows, as of a slice; names and rate stay. The series are views of
        those of the whole run.
        """
        cut = {name: values[begin:end] for name, values in self._list_series().items()}
        cut['time'] = self.time[: end - begin]
        return replace(self, **cut)  # type: ignore[arg-type]

    def _list_series(self) -> dict[str, Matrix]:
        return {
            name: values
            for name, values in vars(self).items()
            if isinstance(values, np.ndarray)
        }

    def save(self, folder: Path) -> None:
        """
        Write the series to ``samples.npz`` in a folder that exists; `load` reads them.

        It is what a run in process leaves in the place of a bag.
        """
        np.savez_compressed(folder / SERIES_FILE, **vars(self))

    @classmethod
    def load(cls, folder: Path) -> RunData:
        """
        Read the series that `save` wrote, from the folder of a run.

        Raises
        ------
        RunError
            If the file is missing or damaged, or lacks a series of this version.

        """
        path = folder / SERIES_FILE
        try:
            with np.load(path, allow_pickle=False) as data:
                values = {field.name: data[field.name] for field in fields(cls)}
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise RunError(
                f'{path}: expected a recording of a run, got {error}'
            ) from None
        values['rate'] = float(values['rate'])
        for name in ('contact_names', 'joint_names'):
            values[name] = tuple(values[name].tolist())
        return cls(**values)


def empty_run_data(ticks: int, controller: ControllerConfig) -> RunData:
    """
    Return series of NaN to be filled in, with the time axis set.

    There are `ticks` rows; a series of joints has a column for each joint of the controller, one
    of contacts for each of its forces and couples.
    """
    joints = controller.robot.joint_names
    contacts = controller.column_names
    widths = WIDTHS | dict.fromkeys(OF_JOINTS, len(joints))
    series = {}
    for field in fields(RunData):
        if field.type == 'Matrix':
            columns = widths.get(field.name, len(contacts))
            series[field.name] = np.full((ticks, columns), np.nan)
    return RunData(
        rate=controller.rate,
        contact_names=contacts,
        joint_names=joints,
        time=np.arange(ticks) / controller.rate,
        **series,
    )


class Missing(NamedTuple):
    """
    A stretch of a run of which no sample was recorded, on the clock of `RunData.time`.

    Samples that were lost at either end are stretches with an infinite bound, since nothing tells
    how many there were.
    """

    begin: float  # since the first sample that is there [s]; minus infinity: from an unknown one
    end: float  # s; infinite: to an unknown end

    def __str__(self) -> str:
        """Return in words from when to when it lasts."""
        if math.isinf(self.begin):
            return 'before the first one that is there'
        if math.isinf(self.end):
            return f'from {self.begin:.2f} s on'
        return f'from {self.begin:.2f} to {self.end:.2f} s'


def describe_missing(missing: Sequence[Missing], what: str = 'samples') -> str:
    """
    Return in words from when to when something, by default the samples, is missing.

    A few stretches are named, and the others counted, so that the line stays readable.
    """
    text = ', '.join(str(each) for each in missing[:GAPS_NAMED])
    if len(missing) > GAPS_NAMED:
        text += f' and {len(missing) - GAPS_NAMED} times more'
    return f'no {what} {text}'


def find_gaps(data: RunData) -> list[Missing]:
    """
    Return the stretches between samples in which more than 0.1 s were not recorded.

    Shorter ones are late or lost messages, which every recording has.
    """
    longest = LONGEST_GAP * data.rate
    return [
        Missing(begin / data.rate, end / data.rate)
        for begin, end in find_true_stretches(~data.recorded())
        if end - begin > longest
    ]


@dataclass(frozen=True)
class BagContent:
    """A bag read back: the series of the run, and what of the run is not in the bag."""

    data: RunData  # by sample stamp
    lacking: tuple[str, ...]  # topics of the controller that are not in the bag
    remarks: tuple[str, ...]  # what could not be read, and what is not there, in words
    start: int  # stamp of the first sample [ns]
    missing: tuple[Missing, ...]  # stretches without samples
    # Of the samples [ns], shape (m,); 0 in rows without one.
    stamps: NDArray[np.int64]
    # Of the c contacts, as indices of `STATE_NAMES`, shape (m, c); NaN before the first status.
    contact_states: Matrix
    images: tuple[str, ...]  # topics of images, which have no series

    @property
    def unanswered(self) -> int:
        """
        Return the number of recorded samples that no commanded torque answers.

        In lockstep there should be none; over a robot's topics those before the first answer may
        be many.
        """
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

    Parameters
    ----------
    path
        Folder of the recording, or one MCAP file.
    controller
        Gives rate, contacts and joints.
    namespace
        Namespace of the graph; None for the only one that is recorded.
    answered
        Whether the samples before the first answer and behind the last one are left out, as they
        are of a robot that was there before the controller.

    Raises
    ------
    RunError
        If the bag cannot be read or holds no samples.

    """
    messages = read_graph(path, namespace)
    return align_messages(path, messages, controller, answered=answered)


def read_graph(path: Path, namespace: str | None = None) -> bag.BagMessages:
    """
    Read the messages of a graph of this package, of all topics that have a series.

    `namespace` is that of the graph; None for the only one. Raises RunError if there are none.
    """
    messages = bag.read_messages(path, TYPES, namespace)
    if not SERIES.keys() & messages.by_topic.keys():
        raise RunError(
            f'{path}: expected samples on joint_states, or another topic of the '
            f'controller, got {messages}'
        )
    return messages


def find_sample_topic(messages: bag.BagMessages) -> str:
    """
    Return the topic that stands for the samples: joint states, or that of most messages.

    A bag that was recorded without the joint states still has a clock in the stamps of another
    series. At least one topic has to be one of `SERIES`.
    """
    counts = {}
    for topic in SERIES:
        if topic in messages.by_topic:
            counts[topic] = len(messages.by_topic[topic])
    if SAMPLES in counts:
        return SAMPLES
    return max(counts, key=counts.__getitem__)


class _SampleClock(NamedTuple):
    """The samples of a recording in the order of their stamps, each once, k of them."""

    stamps: NDArray[np.int64]  # shape (k,) [ns]

    # Of the series, at the control rate: ticks since the first sample.
    rows: NDArray[np.int64]

    published: NDArray[np.uint64]  # when each was sent, shape (k,) [ns since the epoch]

    @property
    def ticks(self) -> int:
        """Return the number of rows from the first sample to the last one, both included."""
        return int(self.rows[-1]) + 1

    def find_rows_after(self, published: NDArray[np.uint64]) -> NDArray[np.int64]:
        """
        Return the row of the next sample that is published after each of some messages.

        Their times are in [ns since the epoch]; behind the last sample is a row more.
        """
        order = np.argsort(self.published)
        places = np.searchsorted(self.published[order], published)
        return np.append(self.rows[order], self.ticks)[places]


def _read_sample_clock(
    path: Path, messages: bag.BagMessages, controller: ControllerConfig
) -> _SampleClock:
    """Return the clock that the samples' stamps are; RunError if they are none."""
    topic = find_sample_topic(messages)
    samples = messages.by_topic[topic]
    # Of several samples with one stamp the newest counts.
    stamps, newest = np.unique(samples.stamps[::-1], return_index=True)
    since_first = (stamps - stamps[0]) * 1e-9
    rows = np.rint(since_first * controller.rate).astype(np.int64)
    clock = _SampleClock(stamps, rows, samples.published[::-1][newest])
    too_sparse = clock.ticks > SPARSE * len(stamps) + controller.rate
    repeated = 2 * len(stamps) < len(samples)
    if too_sparse or repeated:
        raise RunError(
            f'{path}: {topic}: expected stamps {1e3 * controller.period:g} ms apart, got '
            f'{len(samples)} messages with {len(stamps)} stamps over '
            f'{(int(stamps[-1]) - int(stamps[0])) * 1e-9:.3g} s'
        )
    return clock


def align_messages(
    path: Path,
    messages: bag.BagMessages,
    controller: ControllerConfig,
    *,
    answered: bool = False,
) -> BagContent:
    """
    Return the messages that `read_graph` found as series with a row for each sample.

    A message belongs to the sample whose stamp it has; what has no such stamp is left out.
    Arguments and errors are those of `read_bag`.
    """
    clock = _read_sample_clock(path, messages, controller)
    data = empty_run_data(clock.ticks, controller)
    for topic, columns in messages.by_topic.items():
        _fill_series(data, topic, columns, clock)
    status = messages.by_topic.get(OBEYED)
    data = replace(data, command=_commanded_forces(data, status, clock))
    stamps = np.zeros(clock.ticks, dtype=np.int64)
    stamps[clock.rows] = clock.stamps
    states = _told_contact_states(status, clock, controller.contact_names)
    begin = 0
    end = clock.ticks
    if answered:
        begin, end = _find_answered_part(data)
    part = data.part(begin, end)
    lacking = SERIES.keys() - messages.by_topic.keys() - {*OPTIONAL}
    return BagContent(
        part,
        lacking=tuple(topic for topic in SERIES if topic in lacking),
        remarks=_collect_remarks(messages, data),
        start=int(clock.stamps[0]) + round(begin / data.rate * 1e9),
        missing=_missing_stretches(messages, part),
        stamps=stamps[begin:end],
        contact_states=states[begin:end],
        images=tuple(messages.images),
    )


def _fill_series(
    data: RunData, topic: str, columns: bag.BagColumns, clock: _SampleClock
) -> None:
    """Write the messages of a topic into the rows of the samples whose stamps they have."""
    names: Sequence[str] = ()
    if topic in (SAMPLES, COMMANDS):
        names = data.joint_names
    elif TYPES[topic] == bag.JOINT_STATE:
        names = data.contact_names
    places = np.searchsorted(clock.stamps, columns.stamps)
    places = places.clip(max=len(clock.stamps) - 1)
    known = clock.stamps[places] == columns.stamps
    rows = clock.rows[places[known]]
    for series, field in SERIES.get(topic, {}).items():
        values = columns.values(field, names)
        getattr(data, series)[rows] = values[known]


def _missing_stretches(messages: bag.BagMessages, data: RunData) -> tuple[Missing, ...]:
    """Return the stretches without samples, also before the first and after the last one."""
    missing = find_gaps(data)
    if messages.loss.at_begin:
        missing.insert(0, Missing(-math.inf, 0.0))
    if messages.loss.at_end:
        missing.append(Missing(data.ticks / data.rate, math.inf))
    return tuple(missing)


def _find_answered_part(data: RunData) -> tuple[int, int]:
    """Return the first sample that was answered, and the one behind the last, if any was."""
    for series in (data.alpha_meas, data.torque):
        known = np.flatnonzero(np.isfinite(series).any(axis=1))
        if known.size:
            return int(known[0]), int(known[-1]) + 1
    return 0, data.ticks


def _commanded_forces(
    data: RunData, status: bag.BagColumns | None, clock: _SampleClock
) -> Matrix:
    """Return what `~/status` says is obeyed from contact on, else what the controller aims at."""
    command = data.alpha_des.copy()
    if status is None:
        return command
    begins = clock.find_rows_after(status.published)
    obeyed = status.values('effort', data.contact_names)
    for column, name in enumerate(data.contact_names):
        forces = obeyed[:, column]
        named = ~np.isnan(forces)
        is_couple = name.endswith((SUFFIXES[ALONG], SUFFIXES[ACROSS]))
        if named.any() and not is_couple:
            command[:, column] = _force_from_contact_on(
                data.alpha_des[:, column], begins[named], forces[named]
            )
    return command


def hold_until_next(
    ticks: int,
    begins: NDArray[np.int64],
    values: Vector,
    *,
    before: float = math.nan,
) -> Vector:
    """
    Return a series of values that each hold until the next one, shape (ticks,).

    Each of `values` holds from its row in `begins` on, which may be `ticks`, behind the last one;
    `before` holds until the first one.
    """
    told = np.full(ticks + 1, np.nan)
    told[0] = before
    told[begins] = values
    telling_rows = np.where(np.isnan(told), 0, np.arange(ticks + 1))
    return told[np.maximum.accumulate(telling_rows)][:-1]


def _told_contact_states(
    status: bag.BagColumns | None, clock: _SampleClock, contacts: Sequence[str]
) -> Matrix:
    """Return the states that `~/status` tells from the next sample on, shape (m, c)."""
    states = np.full((clock.ticks, len(contacts)), np.nan)
    if status is None:
        return states
    begins = clock.find_rows_after(status.published)
    told = status.values('state', contacts)
    for column in range(len(contacts)):
        known = ~np.isnan(told[:, column])
        states[:, column] = hold_until_next(
            clock.ticks, begins[known], told[known, column]
        )
    return states


def _force_from_contact_on(
    desired: Vector, begins: NDArray[np.int64], forces: Vector
) -> Vector:
    """
    Return the force that one contact was asked for, 0 until the contact is made, shape (m,) [N].

    `desired` is what the controller aimed at, shape (m,) [N]; each of `forces` holds from the
    row in `begins` on. The contact is made where the controller first aims at the whole force.
    """
    asked = hold_until_next(len(desired), begins, forces, before=0.0)
    for begin, end in find_true_stretches(asked > 0.0):
        reached = np.flatnonzero(desired[begin:end] >= REACHED * asked[begin:end])
        if reached.size:
            asked[begin : begin + reached[0]] = 0.0
    return asked


def _collect_remarks(messages: bag.BagMessages, data: RunData) -> tuple[str, ...]:
    """Return what could not be read, and which names did not fit, in words."""
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
