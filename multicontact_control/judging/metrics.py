"""What is read off a run: the metrics of its contacts, the error of its motion, its torque."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
import math
from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.judging.contact_metrics import ContactMetrics
from multicontact_control.judging.run_series import (
    rms_within,
    RunSeries,
    statistic_within,
)
from multicontact_control.runs.scenario import Setup
import numpy as np

NO_TRUTH = 'no ground truth'
MOTION_KEYS = ('position_rms_m', 'moving_position_rms_m', 'orientation_max_rad')


class RunMetrics(RunSeries):
    """
    A run with the metrics of its contacts, of its motion and of its torques.

    Verdict, summary, claims and figures all read them here, so that they cannot differ. Each is
    computed when it is first asked for.
    """

    @cached_property
    def contacts(self) -> list[ContactMetrics]:
        """
        Return the metrics of each of the r columns of contacts.

        A couple of an edge or a plane has metrics of its own, behind those of the normal force of
        its contact.
        """
        return [ContactMetrics(self, column) for column in range(len(self.leaders))]

    def summarise_motion(self) -> dict[str, float | None]:
        """
        Return how well the commanded motion was followed, the `motion` of ``summary.json``.

        The position error counts along the directions that no contact constrains, by the normals
        of simulated surfaces, or those of the controller: under load, and in the window `moving`.
        A recording without a URDF tells no normals, and its errors are None.
        """
        data = self.data
        loaded = self.windows.loaded
        summary: dict[str, float | None] = dict.fromkeys(MOTION_KEYS)
        if loaded.any() and self.setup.controller.robot.urdf:
            normals = self._list_normals()
            free = np.eye(3) - np.linalg.pinv(normals) @ normals
            error = np.linalg.norm((data.position - data.position_des) @ free, axis=1)
            cosine = np.abs((data.quaternion * data.quaternion_des).sum(axis=1))
            angle = 2.0 * np.arccos(np.minimum(cosine, 1.0))
            summary['position_rms_m'] = rms_within(loaded, error)
            summary['moving_position_rms_m'] = rms_within(self.windows.moving, error)
            summary['orientation_max_rad'] = statistic_within(loaded, angle, np.max)
        return summary

    def _list_normals(self) -> Matrix:
        """Return the normals of the contacts as rows, world axes, shape (k, 3)."""
        surfaces: Mapping[str, Any] = self.setup.controller.contacts
        names = self.setup.controller.contact_names
        if self.setup.simulated:
            surfaces = self.setup.plant.surfaces
            names = self.setup.plant.touched
        return np.array([surfaces[name].normal_world for name in names])

    @cached_property
    def least_torque_limit(self) -> Vector:
        """
        Return the smaller of the controller's and the drives' limits, shape (n,) [N m], or inf.

        A robot behind the topics has the controller's alone: what its drives can give is not known
        here.
        """
        limit = torque_limit(self.setup)
        if self.setup.simulated:
            limit = np.minimum(limit, self.setup.plant.torque_limit)
        return limit

    def summarise_torque(self) -> dict[str, float | None]:
        """
        Return how much of the torque limits was used; None without any limit.

        It is the largest share of any joint and sample, the `torque` of ``summary.json``. Samples
        without an answer do not count.
        """
        fraction: Matrix = np.abs(self.data.torque) / self.least_torque_limit
        limited = np.isfinite(fraction) & np.isfinite(self.least_torque_limit)
        return {'max_fraction_of_limit': statistic_within(limited, fraction, np.max)}


def describe_unknown_truth(without: Sequence[str], contacts: Collection[str]) -> str:
    """
    Return in words which of all contacts are `without` a true force; empty if none is.

    Forces of these are judged as measured, so every line that quotes a number says so. Without any
    contact there is no truth at all.
    """
    if contacts and not without:
        return ''
    if len(without) == len(contacts):
        return NO_TRUTH
    return f'{NO_TRUTH} of {", ".join(without)}'


def torque_limit(setup: Setup) -> Vector:
    """
    Return the controller's limits, shape (n,) [N m], infinite where there is none.

    The order is that of `robot.joint_names`. Drives of a simulated plant may give less; see
    `RunMetrics.least_torque_limit`.
    """
    config = setup.controller
    if config.torque_limit:
        return np.array(config.torque_limit)
    return np.full(len(config.robot.joint_names), math.inf)
