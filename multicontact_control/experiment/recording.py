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
    noise_variance: Matrix  # R from the samples up to k, used at k + 1, shape (m, r) [N^2]
    # alpha_meas minus what the observers predicted, 0 where no force is controlled [N].
    innovation: Matrix
    # Of the observers' models, found on-line and its standard error, shape (m, r) [N/m], and how
    # many times as stiff a surface might be; NaN throughout where the stiffness is configured.
    stiffness: Matrix
    stiffness_est: Matrix
    stiffness_std: Matrix
    margin: Matrix
    # Forces commanded over topics, shape (m, r) [N]: from when the contact was made on, 0 where
    # none is asked for; NaN throughout where a scenario says what is asked for.
    command: Matrix
    position: Matrix  # operational point, world axes, shape (m, 3)
    quaternion: Matrix  # scalar last, shape (m, 4)
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
        """Read the series that `save` wrote; RunError if the file is missing or damaged."""
        path = folder / SERIES_FILE
        try:
            with np.load(path, allow_pickle=False) as data:
                values = {f.name: data[f.name] for f in fields(cls)}
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
                         'noise_variance', 'innovation', *OF_STIFFNESS, 'command'),
                        len(contacts)),
        **dict.fromkeys(('position', 'position_des'), 3),
        **dict.fromkeys(('quaternion', 'quaternion_des'), 4)}
    return RunData(
        rate=controller.rate, contact_names=contacts, joint_names=joints,
        time=np.arange(ticks) / controller.rate,
        **{name: np.full((ticks, count), np.nan) for name, count in columns.items()})
