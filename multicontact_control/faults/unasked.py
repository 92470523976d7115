"""Motion that was not asked for, of an arm that is led along a course while it presses."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any, NamedTuple

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.runs.scenario import Setup
import numpy as np

LEAVING = ('retracting', 'given up')  # contacts that are left on purpose
ON_COURSE = 1e-3  # m beside the course, within which it counts as followed
LAG = 2e-3  # m behind the setpoint, up to which nothing holds an arm up
SLACK = 1.5  # of the way aside that a straight edge would need


class Way(NamedTuple):
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
    across: (
        Any  # what is left of a vector across the wanted normals, shape (ticks, 3, 3)
    )
    states: Sequence[tuple[str, ...]]  # of the contacts


def unasked_motion(setup: Setup, way: Way) -> float:
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
    place, setpoint = (
        np.einsum('kij,kj->ki', way.across, points - way.position[0])
        for points in (way.position, way.setpoint)
    )
    along, wanted = place @ way.direction, setpoint @ way.direction
    gap = place - setpoint - np.outer(along - wanted, way.direction)
    largest = max(
        _back(along, wanted), _aside(np.linalg.norm(gap, axis=1), along, wanted)
    )
    for contact, name in enumerate(setup.plant.contact_names):
        normal = np.array(setup.plant.surfaces[name].normal_world)
        largest = max(
            largest, _ahead(setup, way, contact, normal), _off(way, contact, normal)
        )
    return largest


def _back(along: Vector, wanted: Vector) -> float:
    """Return how far a place on the course went away from where it is wanted [m]."""
    asked, gone = np.diff(wanted), np.diff(along)
    left = wanted[1:] - along[:-1]
    together = np.sign(asked) * np.clip(gone * np.sign(asked), 0.0, np.abs(asked))
    away = np.abs(left - (gone - together)) - np.abs(left)
    return in_one_go(away, np.zeros(len(away), dtype=bool))


def _aside(beside: Vector, along: Vector, wanted: Vector) -> float:
    """Return how far a point went aside from the course where nothing held it up [m]."""
    largest = total = 0.0
    left_at, before = along[0], beside[0]
    for distance, place, goal in zip(beside.tolist(), along.tolist(), wanted.tolist()):
        if distance < ON_COURSE:
            left_at = place
        short = abs(goal - place)
        since = max(0.0, (place - left_at) * (1.0 if goal > place else -1.0))
        follows_edge = distance <= SLACK * math.sqrt(since * max(0.0, short - LAG))
        step = distance - before
        total = max(0.0, total + (min(step, 0.0) if follows_edge else step))
        largest, before = max(largest, total), distance
    return largest


def _ahead(setup: Setup, way: Way, contact: int, normal: Vector) -> float:
    """Return how far a tip that is sought went beyond what the approach's speed allows [m]."""
    speed = max(
        setup.controller.contact_state.approach_speed,
        setup.scenario.reference.approach.speed,
    )
    own = np.diff(way.tip[:, contact] - way.tip_setpoint[:, contact], axis=0) @ normal
    sought = way.wanted[1:, contact] & ~way.pressed[1:, contact]
    return in_one_go(own - speed * setup.controller.period, ~sought)


def _off(way: Way, contact: int, normal: Vector) -> float:
    """Return how far a tip that has been at its surface went off it, not on purpose [m]."""
    own = np.diff(way.tip[:, contact] - way.tip_setpoint[:, contact], axis=0) @ normal
    pressed = way.pressed[1:, contact]
    met = np.maximum.accumulate(pressed)
    leaves = np.array([states[contact] in LEAVING for states in way.states[1:]])
    meant = met & way.wanted[1:, contact] & ~leaves & ~pressed
    return in_one_go(-own, ~meant)


def in_one_go(steps: Vector, ended: Mask) -> float:
    """Return the largest sum of neighbouring steps, from where it has not `ended` on."""
    largest = total = 0.0
    for step, is_end in zip(steps.tolist(), ended.tolist()):
        total = 0.0 if is_end else max(0.0, total + step)
        largest = max(largest, total)
    return largest


def across_normals(normals: Matrix, wanted: Mask) -> Any:
    """Return what is left of a vector across the wanted of some normals, shape (ticks, 3, 3)."""
    projections = np.empty((len(wanted), 3, 3))
    for row in np.unique(wanted, axis=0):
        N = normals[row].T
        free = np.eye(3) - N @ np.linalg.pinv(N) if row.any() else np.eye(3)
        projections[(wanted == row).all(axis=1)] = free
    return projections
