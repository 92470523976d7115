"""Motion that was not asked for, of an arm that is led along a course while it presses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.experiment.scenario import Setup
import numpy as np

LEAVING = ('retracting', 'given up')  # contacts that are left on purpose
STILL = 1e-12  # m in a tick, below which a setpoint has no direction


class Way(NamedTuple):
    """Where an arm was and where it should have been, world axes, tick by tick."""

    q: Matrix  # of the links, shape (ticks, n) [rad]
    qd: Matrix  # likewise [rad/s]
    position: Matrix  # of the operational point, shape (ticks, 3) [m]
    setpoint: Matrix  # likewise
    tip: Any  # of every contact, shape (ticks, r, 3) [m]
    tip_setpoint: Any  # where the setpoint has it, without the contact, likewise
    wanted: Mask  # which contacts are commanded, shape (ticks, r)
    pressed: Mask  # which really press, likewise
    across: Any  # what is left of a vector across the wanted normals, shape (ticks, 3, 3)
    states: Sequence[tuple[str, ...]]  # of the contacts


def unasked_motion(setup: Setup, way: Way) -> float:
    """
    Return how far an arm went at most where nothing asked it to [m].

    What counts is motion in one go, less what is taken back, in any of three ways:

    - the operational point goes away from its setpoint, across the normals of the contacts that
      are commanded. To go with the setpoint is asked for, as is to follow a stop or an edge
      towards it; to fall short, or behind, is no motion; the orientation may give way.
    - a tip that is sought goes towards its surface by more than the approach's speed allows.
    - a tip that has been at its surface leaves it, unless the contact is left on purpose.
    """
    largest = in_one_go(_away(way), np.zeros(len(way.position) - 1, dtype=bool))
    for contact, name in enumerate(setup.plant.contact_names):
        normal = np.array(setup.plant.surfaces[name].normal_world)
        largest = max(largest, _ahead(setup, way, contact, normal), _off(way, contact, normal))
    return largest


def _away(way: Way) -> Vector:
    """Return by how much each tick led away from the setpoint, shape (ticks - 1,) [m]."""
    asked, gone, left = (np.einsum('kij,kj->ki', way.across[1:], vectors) for vectors in (
        np.diff(way.setpoint, axis=0), np.diff(way.position, axis=0),
        way.setpoint[1:] - way.position[:-1]))
    length = np.linalg.norm(asked, axis=1)
    along = asked / np.maximum(length, STILL)[:, np.newaxis]
    together = np.clip(np.sum(along * gone, axis=1), 0.0, length)
    own = gone - together[:, np.newaxis] * along
    away: Vector = np.linalg.norm(left - own, axis=1) - np.linalg.norm(left, axis=1)
    return away


def _ahead(setup: Setup, way: Way, contact: int, normal: Vector) -> float:
    """Return how far a tip that is sought went beyond what the approach's speed allows [m]."""
    speed = max(setup.controller.contact_state.approach_speed,
                setup.scenario.reference.approach.speed)
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
