"""Contact normals and lever arms as the columns of N (P04 eqs 1-6, 17)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

from multicontact_control.algebra import component_across, cross, rotate_vector
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.config.contact import ACROSS, FORCE
from multicontact_control.errors import CommandError, ConfigError
from multicontact_control.records import Contact, Records
import numpy as np
from scipy.spatial.transform import Rotation

# Of N with points of length 1; columns are dependent below it.
SMALLEST_SINGULAR_VALUE = 1e-6
LEVERED = 1.05  # N that 1 N of friction is read as, from which on a lever is to blame
# s, in which an estimated normal turns; 0.03 s swings where it is rough.
NORMAL_TIME = 0.06
SURFACE_SPEED_TIME = 0.05  # s, time constant of an estimated speed of a surface
ORIENTATIONS = Rotation.from_rotvec(
    [[0.0, 0.0, 0.0], [0.7, -0.4, 0.3], [-0.2, 1.1, 0.5]]
).as_matrix()  # any, but not special


@compiled
def fill_normal_space(contacts: Records[Contact], rotation: Matrix) -> None:
    """
    Fill in N_i, the wrench that a unit force at contact i makes.

    N_i = [n_i; n_i x l_i] (P04 eq. 5), with the lever l_i = -R p_i from the contact point to
    the operational point, so that n x l = R p x n. A couple of 1 N is that of two forces at a
    distance b on both sides of the centre that differ by 1 N: N_i = [0; b e x n] along a
    direction e of the tool, and [0; b (e - n (n . e))] across it. R has the axes of the
    operational frame as columns.
    """
    for i in range(contacts.shape[0]):
        contact = contacts[i]
        config = contact.config
        if config.kind == FORCE:
            contact.N[:3] = contact.normal
            contact.N[3:] = cross(rotate_vector(rotation, config.point), contact.normal)
            continue
        normal = contacts[config.leader].normal
        direction = rotate_vector(rotation, config.direction)
        contact.N[:3] = 0.0
        if config.kind == ACROSS:
            contact.N[3:] = component_across(direction, normal)
        else:
            contact.N[3:] = cross(direction, normal)
        for k in range(3, 6):  # not as a slice: of one to itself numba makes a copy
            contact.N[k] *= config.half_length


def normal_space(contacts: Records[Contact], rotation_world: Matrix) -> Matrix:
    """Fill in and return N of records of `CONTACT`, world axes, shape (6, r) (P04 eq. 5)."""
    # A copy: a read-only array would be another type, and compiled anew.
    fill_normal_space(contacts, np.array(rotation_world))
    N: Matrix = contacts['N'].T.copy()
    return N


def check_columns(names: Sequence[str], contacts: Records[Contact]) -> None:
    """
    Refuse columns, with these names, that one wrist sensor cannot tell apart.

    Columns of N that are dependent in three orientations of the operational frame are so in any,
    as those of three collinear points or four coplanar ones with one normal.

    Raises
    ------
    ConfigError
        If they depend on each other, as more than six always do.

    """
    copies = contacts.copy()
    reach = max(float(np.abs(contacts['config']['point']).max()), 1e-3)
    units = np.repeat([1.0, 1.0 / reach], 3)  # so that moments count as forces do
    for rotation in ORIENTATIONS:
        N = normal_space(copies, rotation) * units[:, None]
        if np.linalg.matrix_rank(N, SMALLEST_SINGULAR_VALUE) == len(contacts):
            return
    raise ConfigError(
        'contacts',
        'forces none of which the others could have made (independent columns of '
        'N, P04 eq. 5)',
        f'{", ".join(names)}, which depend on each other',
    )


def friction_coupling(contacts: Records[Contact], rotation_world: Matrix) -> Matrix:
    """
    Return what 1 N of friction is read as where nothing is allowed for it.

    Element i, j is the largest force or couple i that 1 N of friction at contact j is read as, in
    any direction across its normal, shape (r, r); 0 where j is a couple [N].
    """
    N_inverse = np.linalg.pinv(normal_space(contacts, rotation_world))
    coupling: Matrix = np.zeros((len(contacts), len(contacts)))
    for j, contact in enumerate(contacts):
        if contact['config']['kind'] != FORCE:
            continue
        across_normal = np.eye(3) - np.outer(contact['normal'], contact['normal'])
        point = rotation_world @ contact['config']['point']
        moments = np.cross(point, across_normal.T).T
        readings = N_inverse @ np.vstack([across_normal, moments])
        coupling[:, j] = np.linalg.norm(readings, axis=1)
    return coupling


def project_on_contacts(way: Vector, columns: Matrix) -> Vector:
    """
    Return the part of a way of the operational point that contacts decide, shape (6,) [m, rad].

    Each force places the tool along its normal, each couple turns it about its axis: a motion has
    no effect there while they are sought or held.

    Parameters
    ----------
    way
        Displacement and rotation vector, world axes, shape (6,) [m, rad].
    columns
        N_i of these contacts as rows, shape (k, 6), see `fill_normal_space`.

    """
    placed = np.zeros(6)
    forces = columns[:, :3].any(axis=1)
    normals = columns[forces, :3].T
    axes = columns[~forces, 3:].T
    placed[:3] = normals @ (np.linalg.pinv(normals) @ way[:3])
    placed[3:] = axes @ (np.linalg.pinv(axes) @ way[3:])
    return placed


def configure_contacts(config: ControllerConfig, columns: Records[Contact]) -> None:
    """Fill records of `CONTACT`, shape (r,), with the configuration of the columns of N."""
    for record, column in zip(columns, config.columns):
        known = record['config']
        contact = config.contacts[column.contact]
        is_force = column.kind == FORCE
        known['kind'] = column.kind
        known['leader'] = column.leader
        normal = contact.normal_world if is_force else (0.0, 0.0, 0.0)
        # A normal that has been estimated is kept while its configuration is.
        if (known['normal'] != normal).any() or not contact.normal_turn_rate:
            record['normal'] = normal
            known['normal'] = normal
        known['normal_gain'] = config.period / (NORMAL_TIME + config.period)
        known['turn_limit'] = contact.normal_turn_rate * config.period
        known['smallest_cosine'] = math.cos(contact.normal_range)
        known['point'] = contact.point_operational
        known['tool_axis'] = contact.tool_axis_operational
        known['tool_turn_limit'] = contact.tool_turn_limit
        known['direction'] = contact.direction_operational
        known['half_length'] = column.half_length
        record['stiffness'] = column.stiffness
        if is_force:
            known['surface_speed'] = contact.surface_speed
            known['surface_gain'] = config.period / (SURFACE_SPEED_TIME + config.period)
            limit = contact.surface_speed_limit
            known['surface_speed_limit'] = limit
            record['surface_speed_est'] = np.clip(
                record['surface_speed_est'], -limit, limit
            )
            known['friction_coefficient'] = contact.friction_coefficient
            known['friction_std'] = contact.friction_std
            # A point bears no torque about its normal.
            lever = 0.0 if contact.type == 'point' else contact.half_length
            known['torsion_std'] = contact.friction_std * lever


def find_misread_friction(
    config: ControllerConfig,
    columns: Records[Contact],
    rotation_world: Matrix,
) -> list[tuple[str, str, float]]:
    """
    Return where a lever turns friction into more than itself.

    Of contacts whose friction is neither expected nor allowed for: the name, the force or couple
    that the friction is read as, and how much of that 1 N is [N].
    """
    coupling = friction_coupling(columns.copy(), rotation_world)
    names = config.column_names
    misread = []
    for j in config.force_columns:
        contact = config.contacts[names[j]]
        if contact.friction_std or contact.friction_coefficient:
            continue
        for name, reading in zip(names, coupling[:, j].tolist()):
            if reading > LEVERED:
                misread.append((names[j], name, reading))
    return misread


def offset_shares(
    config: ControllerConfig, centres: Mapping[str, float]
) -> dict[str, float]:
    """
    Return couples, relative to the normal force, for centres of pressure by the couple's name [m].

    A name that is not that of a couple, or a number that is not finite, is a CommandError.
    """
    halves = {
        column.name: column.half_length
        for column in config.columns
        if column.half_length
    }
    for name, centre in centres.items():
        if name not in halves or not math.isfinite(centre):
            expected = 'an edge or plane'
            if halves:
                expected = f'a finite one of {", ".join(halves)}'
            raise CommandError(
                'centre of pressure', expected, f"'{name}': {centre:g} m"
            )
    return {name: centre / halves[name] for name, centre in centres.items()}
