"""Motion that was not asked for, of an arm that is led along a course while it presses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import math
from typing import Any, NamedTuple

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.runs.scenario import Setup
import numpy as np

LEAVING = ('retracting', 'given up')  # contacts that are left on purpose
ON_COURSE = 1e-3  # m beside the course, within which it counts as followed
LAG = 2e-3  # m behind the setpoint, up to which nothing holds an arm up
SLACK = 1.5  # of the way aside that a straight edge would need
ENDED = -math.inf  # in the place of a step, where motion does not count


class MotionTrace(NamedTuple):
    """Where an arm was and where it should have been, world axes, tick by tick."""

    direction: Vector  # of the course, a unit vector or 0, shape (3,)
    q: Matrix  # of the links, shape (ticks, n) [rad]
    qd: Matrix  # likewise [rad/s]
    position: Matrix  # of the operational point, shape (ticks, 3) [m]
    setpoint: Matrix  # likewise
    tip: Any  # of every contact, shape (ticks, r, 3) [m]
    tip_setpoint: Any  # where the setpoint has it, without the contact, likewise
    wanted: Mask  # which contacts are commanded, shape (ticks, r)
    pressed: Mask  # which really press, likewise
    # What is left of a vector across the wanted normals, shape (ticks, 3, 3).
    across: Any
    states: Sequence[tuple[str, ...]]  # of the contacts

    def project_points(self, points: Matrix) -> Matrix:
        """
        Return the ways from the first position to some points, across the wanted normals [m].

        A row for each tick, shape (ticks, 3). Along the normals the surfaces decide where the arm
        is, and not the course.
        """
        ways = points - self.position[0]
        projected: Matrix = np.einsum('kij,kj->ki', self.across, ways)
        return projected

    def tip_steps(self, contact: int, normal: Vector) -> Vector:
        """
        Return how far a tip goes along a normal beside its setpoint in each tick [m].

        Shape (ticks - 1,), positive along `normal`, a unit vector in world axes. What the setpoint
        itself does is not counted.
        """
        beside = self.tip[:, contact] - self.tip_setpoint[:, contact]
        steps: Vector = np.diff(beside, axis=0) @ normal
        return steps


def unasked_motion(setup: Setup, trace: MotionTrace) -> float:
    """
    Return how far an arm went at most where nothing asked it to [m].

    What counts is motion in one go, less what is taken back, in any of four ways:

    - the operational point goes away from its setpoint along the course. To go with the setpoint
      is asked for; to fall short, or behind, is no motion. What counts is across the normals of
      the contacts that are commanded; the orientation may give way.
    - it goes aside from the course, unless a stop or an edge holds it up, along which it comes
      nearer to its setpoint: from where it left the course to the nearest place on a straight
      edge it stays within the circle over the way to the setpoint (Thales).
    - a tip that is sought goes towards its surface by more than the approach's speed allows.
    - a tip that has been at its surface leaves it, unless the contact is left on purpose.
    """
    position = trace.project_points(trace.position)
    setpoint = trace.project_points(trace.setpoint)
    along = position @ trace.direction
    wanted = setpoint @ trace.direction
    gap = position - setpoint - np.outer(along - wanted, trace.direction)
    beside = np.linalg.norm(gap, axis=1)
    motions = [_motion_away(along, wanted), _motion_aside(beside, along, wanted)]
    for contact, name in enumerate(setup.plant.contact_names):
        normal = np.array(setup.plant.surfaces[name].normal_world)
        motions.append(_motion_beyond_approach(setup, trace, contact, normal))
        motions.append(_motion_off_surface(trace, contact, normal))
    return max(motions)


def _motion_away(along: Vector, wanted: Vector) -> float:
    """Return how far a place on the course went away from where it is wanted [m]."""
    asked = np.diff(wanted)
    gone = np.diff(along)
    missing = wanted[1:] - along[:-1]
    way_asked_for = np.clip(gone * np.sign(asked), 0.0, np.abs(asked))
    with_setpoint = np.sign(asked) * way_asked_for
    away = np.abs(missing - (gone - with_setpoint)) - np.abs(missing)
    return largest_motion_in_one_go(away)


def _motion_aside(beside: Vector, along: Vector, wanted: Vector) -> float:
    """Return how far a point went aside from the course where nothing held it up [m]."""
    steps = []
    left_at = along[0]
    before = beside[0]
    for distance, place, goal in zip(beside.tolist(), along.tolist(), wanted.tolist()):
        if distance < ON_COURSE:
            left_at = place
        short = abs(goal - place)
        towards_goal = place - left_at
        if goal <= place:
            towards_goal = left_at - place
        way_since = max(0.0, towards_goal)
        edge_distance = math.sqrt(way_since * max(0.0, short - LAG))
        step = distance - before
        if distance <= SLACK * edge_distance:  # it follows an edge
            step = min(step, 0.0)
        steps.append(step)
        before = distance
    return largest_motion_in_one_go(steps)


def _motion_beyond_approach(
    setup: Setup, trace: MotionTrace, contact: int, normal: Vector
) -> float:
    """Return how far a tip that is sought went beyond what the approach's speed allows [m]."""
    speed = max(
        setup.controller.contact_state.approach_speed,
        setup.scenario.reference.approach.speed,
    )
    steps = trace.tip_steps(contact, normal) - speed * setup.controller.period
    is_sought = trace.wanted[1:, contact] & ~trace.pressed[1:, contact]
    return largest_motion_in_one_go(np.where(is_sought, steps, ENDED))


def _motion_off_surface(trace: MotionTrace, contact: int, normal: Vector) -> float:
    """Return how far a tip that has been at its surface went off it, not on purpose [m]."""
    steps = trace.tip_steps(contact, normal)
    pressed = trace.pressed[1:, contact]
    has_pressed = np.maximum.accumulate(pressed)
    leaves = np.array([states[contact] in LEAVING for states in trace.states[1:]])
    should_press = has_pressed & trace.wanted[1:, contact] & ~leaves & ~pressed
    return largest_motion_in_one_go(np.where(should_press, -steps, ENDED))


def largest_motion_in_one_go(steps: Iterable[float]) -> float:
    """
    Return the largest sum of neighbouring steps [m].

    Parameters
    ----------
    steps
        Of every tick, negative where motion is taken back, `ENDED` where a sum begins anew [m].

    """
    largest = 0.0
    total = 0.0
    for step in steps:
        total = max(0.0, total + step)
        largest = max(largest, total)
    return float(largest)


def project_across_normals(normals: Matrix, wanted: Mask) -> Any:
    """
    Return what is left of a vector across the wanted of some normals, shape (ticks, 3, 3).

    Parameters
    ----------
    normals
        Unit vectors, shape (r, 3).
    wanted
        Which of them count in a tick, shape (ticks, r).

    """
    projections = np.empty((len(wanted), 3, 3))
    for row in np.unique(wanted, axis=0):
        free = np.eye(3)
        if row.any():
            N = normals[row].T
            free = np.eye(3) - N @ np.linalg.pinv(N)
        projections[(wanted == row).all(axis=1)] = free
    return projections
