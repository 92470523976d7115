"""What an observation holds: the arm, and at each contact what is known of its force."""

from __future__ import annotations

from typing import Any

from gymnasium import spaces
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import ControlOutput
from multicontact_control.learning.config import EnvironmentConfig
from multicontact_control.supervision.contacts import STATE_NAMES
import numpy as np

# Bounds, far beyond what an arm reaches; a number beyond them is clipped.
FARTHEST = 10.0  # m
FASTEST = 100.0  # m/s and rad/s
LARGEST_WRENCH = 1000.0  # N and N m
STIFFEST = 1e6  # N/m

Observation = dict[str, Any]


def observation_space(
    config: EnvironmentConfig, controller: ControllerConfig, action_size: int
) -> spaces.Dict:
    """
    Return the space of what `observe` returns; all are vectors of float64 but states and action.

    Forces and couples are in the order of the controller's columns.
    """
    columns = len(controller.columns)
    contacts = len(controller.contact_names)

    def box(largest: float, count: int, smallest: float | None = None) -> spaces.Box:
        if smallest is None:
            smallest = -largest
        return spaces.Box(smallest, largest, (count,), np.float64)

    return spaces.Dict(
        {
            'position': box(FARTHEST, 3),
            'quaternion': box(1.0, 4),
            'twist': box(FASTEST, 6),
            'wrench': box(LARGEST_WRENCH, 6),
            'path_error': box(FARTHEST, 3),
            'force_target': box(LARGEST_WRENCH, columns),
            'force_measured': box(LARGEST_WRENCH, columns),
            'force_estimated': box(LARGEST_WRENCH, columns),
            'force_desired': box(LARGEST_WRENCH, columns),
            'force_variance': box(controller.noise_variance.largest, columns, 0.0),
            'stiffness': box(STIFFEST, columns, 0.0),
            'contact_state': spaces.MultiDiscrete([len(STATE_NAMES)] * contacts),
            'action': spaces.Box(-1.0, 1.0, (action_size,), np.float32),
            'force_window': box(LARGEST_WRENCH, config.window * columns),
        }
    )


def observe(
    space: spaces.Dict,
    output: ControlOutput,
    states: tuple[str, ...],
    forces_target: Vector,
    path_error: Vector,
    window: Matrix,
    action: Vector,
) -> Observation:
    """
    Return what is known of the newest answered sample.

    Parameters
    ----------
    space
        That bounds the numbers.
    output
        The answer to that sample.
    states
        Of the contacts, by name.
    forces_target, path_error
        What the scenario asks for, shape (r,) [N], and the way to its path, shape (3,) [m].
    window
        The newest measured forces, oldest first, shape (k, r) [N].
    action
        The newest one, as it was obeyed.

    """
    frame = output.controls['frame'][0]
    contacts = output.contacts
    estimated = contacts['stiffness_est']
    values = {
        'position': frame['position'],
        'quaternion': output.pose.quaternion_xyzw,
        'twist': frame['twist'],
        'wrench': output.controls['wrench'][0],
        'path_error': path_error,
        'force_target': forces_target,
        'force_measured': contacts['alpha_meas'],
        'force_estimated': output.answer['alpha_est'],
        'force_desired': output.answer['alpha_des'],
        'force_variance': contacts['noise_variance'],
        # Where nothing is estimated, the model's.
        'stiffness': np.where(estimated > 0.0, estimated, contacts['stiffness']),
        'action': action,
        'force_window': window.ravel(),
    }
    observation: Observation = {}
    for name, box in space.items():
        if isinstance(box, spaces.Box):
            bounded = np.clip(values[name], box.low, box.high)
            observation[name] = bounded.astype(box.dtype)
        else:
            numbers = [STATE_NAMES.index(state) for state in states]
            observation[name] = np.array(numbers, dtype=np.int64)
    return observation
