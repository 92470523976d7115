"""Recordings made by hand, with known answers to what is measured on them."""

from __future__ import annotations

from dataclasses import replace

from multicontact_control.runs.recording import empty_run_data, RunData
from multicontact_control.runs.scenario import Setup
import numpy as np

# Series that are zero in a perfect run.
RESTING = (
    'q',
    'qd',
    'effort',
    'torque',
    'wrench',
    'wrench_filtered',
    'alpha_rate_est',
    'position',
    'position_des',
)


def perfect_run(setup: Setup) -> RunData:
    """Return a run of the scenario in which every force is its command, at once."""
    data = empty_run_data(setup.ticks, setup.controller)
    reference = setup.scenario.reference
    desired = np.full((data.ticks, len(data.contact_names)), reference.approach.preload)
    for step in reference.force_steps:
        for name, force in step.forces.items():
            desired[data.time >= step.time, data.contact_names.index(name)] = force
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (data.ticks, 1))
    variance = np.full_like(desired, 0.6)
    variance[data.time >= reference.motion.start_time] = 100.0
    return replace(
        data,
        **{name: np.zeros_like(getattr(data, name)) for name in RESTING},
        alpha_true=desired.copy(),
        alpha_meas=desired.copy(),
        alpha_est=desired.copy(),
        alpha_des=desired,
        noise_variance=variance,
        quaternion=turn,
        quaternion_des=turn,
    )


def paper_run(setup: Setup) -> RunData:
    """Return a run in which all that one run can tell of the claims holds."""
    data = perfect_run(setup)
    rng = np.random.default_rng(0)
    error = 0.01 * rng.standard_normal(data.alpha_true.shape)
    moving = data.time >= setup.scenario.reference.motion.start_time
    error[moving] = 0.5 * rng.standard_normal(error[moving].shape)
    true = delayed(data, 0.05) + error
    return replace(data, alpha_true=true, alpha_meas=true)


def delayed(data: RunData, delay: float) -> np.ndarray:
    """Return the commanded forces, later."""
    shift = round(delay * data.rate)
    later = np.roll(data.alpha_des, shift, axis=0)
    later[:shift] = data.alpha_des[0]
    return later
