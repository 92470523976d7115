"""What speaks against an answer of the control law, as compiled code wants it."""

from __future__ import annotations

from typing import Any

from multicontact_control.config import ControllerConfig
from multicontact_control.supervision.gate_kernels import PLAUSIBILITY
import numpy as np

BOX_EXCESS = 0.01  # m beyond the box, that the reference did not prevent


def plausibility_limits(config: ControllerConfig) -> Any:
    """Return what speaks against an answer: one record of `PLAUSIBILITY`."""
    suspicion = np.zeros(1, dtype=PLAUSIBILITY)
    for name in ('pull_threshold', 'friction_bound', 'friction_offset'):
        suspicion[name] = getattr(config.watchdog, name)
    suspicion['inertia'] = config.tool.mass * config.watchdog.loss_acceleration
    suspicion['bias'] = config.tool.bias_sensor[:3]
    suspicion['weight'] = config.tool.mass * np.array(config.robot.gravity_world)
    limits, everywhere = config.limits, np.full(3, np.inf)
    suspicion['box'] = (
        np.array(limits.workspace_lower or -everywhere) - BOX_EXCESS,
        np.array(limits.workspace_upper or everywhere) + BOX_EXCESS)
    return suspicion
