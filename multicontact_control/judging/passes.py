"""
The passes of a run along a path, and what the forces were on each.

A pass is a stretch of the commanded path between two turns: half a stroke of a sine, a leg through
waypoints, a turn of a circle. It ends

- where the commanded motion along the surfaces stops;
- in the middle of a corner, where the direction turns by more than 60 degrees in half a second.
  What turns as fast for longer than it takes to turn back, 1.5 s, is a curve and no corner;
- where the direction has turned by 360 degrees in all since the pass began.

Stretches shorter than 5 mm are no passes.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

from multicontact_control.arrays import find_true_stretches, Mask, Matrix, Vector
from multicontact_control.contact.wrench import contact_wrench
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.files import replace_binary_file, replace_text_file
from multicontact_control.judging.contact_metrics import ContactMetrics
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.run_folders import PASSES_FILE, PASSES_TABLE
from multicontact_control.judging.run_series import LEAST_MOVING_SPEED, RunSeries
import numpy as np
from numpy.typing import NDArray
import pandas as pd
from scipy.spatial.transform import Rotation

SMOOTHING_TIME = 0.1  # s, over which the commanded velocity is taken
CORNER_ANGLE = math.radians(60.0)
CORNER_TIME = 0.5  # s, in which a corner turns by more than that
LONGEST_CORNER = CORNER_TIME * math.pi / CORNER_ANGLE  # s
FULL_TURN = 2.0 * math.pi
LEAST_LENGTH = 5e-3  # m, of a pass
# Share of the commanded force by which a force may be off.
FORCE_BAND = 0.1


class Pass(NamedTuple):
    """
    A stretch of a run along its path, from one turn to the next.

    Some of its samples may not have been recorded.
    """

    begin: int  # first row
    end: int  # row behind the last one
    length: float  # of the commanded path along the surfaces [m]


class RunPasses:
    """
    The passes of a run and the contacts that press on them.

    They follow from the commanded poses and forces alone, so that a recording of the user's own
    robot has them, too. Only where a force is asked for there are any.

    Parameters
    ----------
    run
        The run with its metrics.

    Attributes
    ----------
    contacts
        Metrics of the normal force of each contact, without couples.
    asked
        Which samples a force is asked for in, also those that were not recorded, shape
        (m, contacts).
    distance
        Commanded way along the surfaces since the first sample, shape (m,) [m].
    passes
        In the order of time; none without a path.

    """

    def __init__(self, run: RunMetrics) -> None:
        self.run = run
        self.contacts = [each for each in run.contacts if not each.is_couple]
        commanded = [contact.command for contact in self.contacts]
        known = pd.DataFrame(np.column_stack(commanded)).ffill()
        self.asked: Mask = known.to_numpy() > 0.0
        steps = self._list_steps_along_surfaces()
        self.distance: Vector = np.cumsum(np.linalg.norm(steps, axis=1))
        self.passes = self._find_passes(np.cumsum(steps, axis=0))

    def _find_passes(self, way: Matrix) -> list[Pass]:
        """Return the passes of a way along the surfaces, shape (m, 3) [m]."""
        samples = SMOOTHING_TIME * self.run.data.rate
        velocity = _find_change_around(way, samples) / SMOOTHING_TIME
        speed = np.linalg.norm(velocity, axis=1)
        moving = (speed > LEAST_MOVING_SPEED) & self.asked.any(axis=1)
        passes = []
        for first, last in find_true_stretches(moving):
            heading = _find_heading(velocity[first:last])
            begin = first
            for turn in [*_find_turns(heading, self.run.data.rate), last - first]:
                end = first + turn
                length = float(self.distance[end - 1] - self.distance[begin])
                if length >= LEAST_LENGTH:
                    passes.append(Pass(begin, end, length))
                begin = end
        return passes

    def _list_steps_along_surfaces(self) -> Matrix:
        """
        Return how far the commanded point goes along the surfaces in each sample, (m, 3) [m].

        What it goes along the controller's normals of the contacts that are asked for is left out,
        as these place the tool there; normals are not known of a recording without a URDF. Samples
        that were not recorded are interpolated.
        """
        poses = pd.DataFrame(self.run.data.position_des)
        positions = poses.interpolate(limit_direction='both').to_numpy()
        steps: Matrix = np.diff(positions, axis=0, prepend=positions[:1])
        config = self.run.setup.controller
        if config.robot.urdf:
            configured = [config.contacts[each.name] for each in self.contacts]
            normals = np.array([contact.normal_world for contact in configured])
            for asked in np.unique(self.asked, axis=0):
                rows = (self.asked == asked).all(axis=1)
                into_surfaces = np.linalg.pinv(normals[asked]) @ normals[asked]
                steps[rows] -= steps[rows] @ into_surfaces
        return steps

    def tabulate(self) -> pd.DataFrame:
        """
        Return the table of the passes: a row for each contact that presses on a pass.

        Names of columns end with their units, shares are those of time; docs/verdicts.md says what
        they are. Samples whose force is not known do not count; contact and pass have no row
        without any.
        """
        works = self._measure_works()
        rows = []
        for number, stretch in enumerate(self.passes):
            begin = stretch.begin / self.run.data.rate
            end = stretch.end / self.run.data.rate
            for contact, window in zip(self.contacts, self.list_windows(stretch)):
                if not window.any():
                    continue
                row = {
                    'pass': number + 1,
                    'contact': contact.name,
                    'begin_s': begin,
                    'end_s': end,
                    'length_m': stretch.length,
                    'mean_speed_m_s': stretch.length / (end - begin),
                    **_measure_force(contact, window),
                    'friction_work_all_contacts_j': works[number],
                }
                rows.append(row)
        return pd.DataFrame(rows)

    def list_windows(self, stretch: Pass) -> list[Mask]:
        """
        Return the samples of a pass that count for each contact, shape (m,) each.

        In these its force is asked for and known.
        """
        within = np.zeros(self.run.data.ticks, dtype=bool)
        within[stretch.begin : stretch.end] = True
        windows = []
        for contact, asked in zip(self.contacts, self.asked.T):
            windows.append(within & asked & np.isfinite(contact.error))
        return windows

    def _measure_works(self) -> list[float]:
        """
        Return what work friction takes on each pass [J], NaN where it is not known.

        It is the work of the tool's wrench along the measured motion of the operational point.
        Normal forces do none on a surface at rest, wherever the normal points. The wrench is that
        of the sensor, less bias and weight of the configured tool.
        """
        if not (self.passes and self.run.setup.controller.robot.urdf):
            return [math.nan] * len(self.passes)
        tool = _SensedTool(self.run)
        return [tool.measure_work(stretch) for stretch in self.passes]


class _SensedTool:
    """What a tool does to the surfaces by the wrist sensor, where pose and reading are known."""

    def __init__(self, run: RunSeries) -> None:
        config = run.setup.controller
        self._data = run.data
        self._tool = config.tool
        self._gravity = np.array(config.robot.gravity_world)
        self._readings: Matrix = getattr(run.data, config.wrench_series)
        poses = np.hstack([run.data.position, run.data.quaternion])
        series = np.hstack([self._readings, poses])
        self.known: Mask = np.isfinite(series).all(axis=1)
        # One link carries sensor and operational point, so that any posture tells how they lie.
        robot = RobotModel(config.robot, run.setup.urdf_dir)
        rest = np.zeros(robot.joint_count)
        robot.compute(rest, rest)
        terms = robot.terms
        to_operational = terms.rotation.T
        self._lever: Vector = to_operational @ (terms.sensor_position - terms.position)
        self._axes: Matrix = to_operational @ terms.sensor_rotation

    def measure_work(self, stretch: Pass) -> float:
        """Return the work of the tool on a pass, NaN if fewer than two samples are known [J]."""
        begin, end, _ = stretch
        rows = begin + np.flatnonzero(self.known[begin:end])
        if rows.size < 2:
            return math.nan
        turns = Rotation.from_quat(self._data.quaternion[rows])
        wrenches = self._find_wrenches(rows, turns.as_matrix())
        mean_wrenches = 0.5 * (wrenches[1:] + wrenches[:-1])
        moved = np.diff(self._data.position[rows], axis=0)
        turned = (turns[1:] * turns[:-1].inv()).as_rotvec()
        return float((mean_wrenches * np.hstack([moved, turned])).sum())

    def _find_wrenches(self, rows: NDArray[np.int64], rotations: Matrix) -> Matrix:
        """
        Return the wrenches at the operational point in some rows, shape (k, 6) [N, N m].

        Axes are those of the world; `rotations`, shape (k, 3, 3), have those of the operational
        frame as columns.
        """
        positions = self._data.position[rows]
        origins = positions + rotations @ self._lever
        axes = rotations @ self._axes
        readings = self._readings[rows]
        wrenches = np.empty((len(rows), 6))
        for k in range(len(rows)):
            sensor_pose = origins[k], axes[k]
            wrenches[k] = contact_wrench(
                readings[k], sensor_pose, positions[k], self._tool, self._gravity
            )
        return wrenches


def _find_change_around(series: Matrix, samples: float) -> Matrix:
    """Return by how much a series changes within some samples around each of its rows."""
    rows = np.arange(len(series))
    reach = max(1, round(0.5 * samples))
    after = np.minimum(rows + reach, len(series) - 1)
    before = np.maximum(rows - reach, 0)
    change: Matrix = series[after] - series[before]
    return change


def _find_heading(velocity: Matrix) -> Vector:
    """
    Return the direction of velocities, shape (k, 3), as an angle that goes on [rad], (k,).

    It is counted in the plane that they lie in, or nearest to.
    """
    _, axes = np.linalg.eigh(velocity.T @ velocity)
    _, second, first = axes.T
    heading: Vector = np.unwrap(np.arctan2(velocity @ second, velocity @ first))
    return heading


def _find_turns(heading: Vector, rate: float) -> list[int]:
    """Return the rows at which a motion without a stop begins a new pass, in their order."""
    begin = 0
    turns = []
    for end in [*_find_corners(heading, rate), len(heading)]:
        turned = _find_full_turn(heading[begin:end])
        while turned:
            begin += turned
            turns.append(begin)
            turned = _find_full_turn(heading[begin:end])
        turns.append(end)
        begin = end
    return turns[:-1]


def _find_corners(heading: Vector, rate: float) -> list[int]:
    """Return the middle row of every corner."""
    sharp = np.abs(_find_change_around(heading, CORNER_TIME * rate)) > CORNER_ANGLE
    corners = []
    for begin, end in find_true_stretches(sharp):
        if end - begin <= LONGEST_CORNER * rate:
            corners.append((begin + end) // 2)
    return corners


def _find_full_turn(heading: Vector) -> int:
    """Return the first row at which a direction has turned by 360 degrees, 0 if at none."""
    return int(np.argmax(np.abs(heading - heading[0]) >= FULL_TURN))


def _measure_force(contact: ContactMetrics, window: Mask) -> dict[str, Any]:
    """Return what the table says of a contact's force in a window in which it is known."""
    force = contact.force[window]
    command = contact.command[window]
    outside = np.abs(contact.error[window]) > FORCE_BAND * command
    return {
        'force_is_true': contact.has_truth,
        'force_mean_n': float(force.mean()),
        'force_std_n': float(force.std()),
        'force_min_n': float(force.min()),
        'force_max_n': float(force.max()),
        'command_mean_n': float(command.mean()),
        'outside_band_share': float(outside.mean()),
        'no_contact_share': contact.find_lost_share(window),
    }


def write_passes(run: RunMetrics, folder: Path) -> pd.DataFrame:
    """
    Write the passes of a run into a folder, and return their table.

    ``passes.csv`` and ``passes.parquet`` are the same, and each is replaced as a whole. A run
    without a path has an empty table, and no files.
    """
    table = RunPasses(run).tabulate()
    if len(table):
        text = table.to_csv(index=False)
        replace_text_file(folder / PASSES_FILE, text)
        replace_binary_file(folder / PASSES_TABLE, table.to_parquet(index=False))
    return table
