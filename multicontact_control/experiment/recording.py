"""The series of one run, tick by tick, wherever they were recorded."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
import hashlib
from pathlib import Path
from typing import Any
import zipfile

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.errors import RunError
import numpy as np

SERIES_FILE = 'samples.npz'
OF_STIFFNESS = ('stiffness', 'stiffness_est', 'stiffness_std', 'margin')
OPTIONAL = ('innovation', *OF_STIFFNESS, 'command')


@dataclass(frozen=True)
class RunData:
    """
    Every series of a run; row k belongs to sample k, NaN where a message is missing.

    Attributes
    ----------
    rate
        Samples per second [Hz].
    contact_names, joint_names
        Order of the contact and joint columns.
    time
        Time since the first sample, shape (m,) [s].
    q, qd, effort, torque
        Joint position, velocity, measured and commanded torque, shape (m, n).
    wrench, wrench_filtered
        What the wrist sensor reads, in its frame, shape (m, 6).
    alpha_true, alpha_meas, alpha_est, alpha_rate_est, alpha_des
        Contact forces [N] and the estimate's rate [N/s], shape (m, r).
    noise_variance
        R estimated from the samples up to k (the controller uses it at k + 1), shape (m, r).
    innovation
        alpha_meas minus what the observers predicted, 0 where no force is controlled, shape
        (m, r) [N]; NaN throughout where it was not recorded.
    stiffness, stiffness_est, stiffness_std, margin
        That of the observers' models, what is estimated on-line and its standard error, and how
        many times as stiff a surface might be, shape (m, r) [N/m], [N/m], [N/m], [-]; NaN
        throughout where the stiffness is configured.
    command
        Forces commanded over topics, shape (m, r) [N]: from when the contact was made on, 0 where
        none is asked for; NaN throughout where a scenario says what is asked for.
    position, quaternion, position_des, quaternion_des
        Operational point, world axes, shapes (m, 3) and (m, 4), scalar last.

    """

    rate: float
    contact_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    time: Vector
    q: Matrix
    qd: Matrix
    effort: Matrix
    torque: Matrix
    wrench: Matrix
    wrench_filtered: Matrix
    alpha_true: Matrix
    alpha_meas: Matrix
    alpha_est: Matrix
    alpha_rate_est: Matrix
    alpha_des: Matrix
    noise_variance: Matrix
    innovation: Matrix
    stiffness: Matrix
    stiffness_est: Matrix
    stiffness_std: Matrix
    margin: Matrix
    command: Matrix
    position: Matrix
    quaternion: Matrix
    position_des: Matrix
    quaternion_des: Matrix

    @property
    def ticks(self) -> int:
        """Return the number of samples."""
        return int(self.time.shape[0])

    def trajectory_sha256(self) -> str:
        """Return the hash of the commanded torques as little-endian float64, tick by tick."""
        return hashlib.sha256(np.ascontiguousarray(self.torque, dtype='<f8').tobytes()).hexdigest()

    def truncated(self, ticks: int) -> RunData:
        """Return the first `ticks` samples."""
        return self.part(0, ticks)

    def part(self, begin: int, end: int) -> RunData:
        """Return the samples from one up to another; time begins with the first of them."""
        series: dict[str, Any] = {
            f.name: getattr(self, f.name)[begin:end] for f in fields(self)
            if isinstance(getattr(self, f.name), np.ndarray)}
        return replace(self, **{**series, 'time': self.time[:end - begin]})

    def save(self, folder: Path) -> None:
        """Write the series to ``samples.npz`` in a folder."""
        values: dict[str, Any] = {
            f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
        with (folder / SERIES_FILE).open('wb') as file:
            np.savez_compressed(file, **values)

    @classmethod
    def load(cls, folder: Path) -> RunData:
        """
        Read the series that `save` wrote.

        Raises
        ------
        RunError
            If the file is missing or damaged.

        """
        path = folder / SERIES_FILE
        try:
            with np.load(path, allow_pickle=False) as data:
                values = {name: data[name] for name in data.files}
            # Recordings from before these were kept are as good otherwise.
            for name in OPTIONAL:
                values.setdefault(name, np.full_like(values['alpha_meas'], np.nan))
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise RunError(f'{path}: expected a recording of a run, found {error}') from None
        return cls(**{**values, 'rate': float(values['rate']),
                      'contact_names': tuple(str(name) for name in values['contact_names']),
                      'joint_names': tuple(str(name) for name in values['joint_names'])})


def empty_run_data(ticks: int, controller: ControllerConfig) -> RunData:
    """Return series of NaN to be filled in, with the time axis set."""
    joints, contacts = controller.robot.joint_names, controller.column_names
    columns = {
        **dict.fromkeys(('q', 'qd', 'effort', 'torque'), len(joints)),
        **dict.fromkeys(('wrench', 'wrench_filtered'), 6),
        **dict.fromkeys(('alpha_true', 'alpha_meas', 'alpha_est', 'alpha_rate_est', 'alpha_des',
                         'noise_variance', *OPTIONAL), len(contacts)),
        **dict.fromkeys(('position', 'position_des'), 3),
        **dict.fromkeys(('quaternion', 'quaternion_des'), 4)}
    return RunData(
        rate=controller.rate, contact_names=contacts, joint_names=joints,
        time=np.arange(ticks) / controller.rate,
        **{name: np.full((ticks, count), np.nan) for name, count in columns.items()})
