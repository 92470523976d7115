"""
The configuration of the controller and the estimator: every tunable value, once.

Each field declares default, unit, description and range. The ROS parameters of the nodes are made
from these models, which also validate the files in ``config/``.
"""

from multicontact_control.config.base import (
    Config,
    merge,
    parameter,
    read_parameters,
    read_yaml,
    UnitVector3,
    validate,
    Vector,
    Vector3,
)
from multicontact_control.config.controller import ControllerConfig, MAX_DELAY_PERIODS
from multicontact_control.config.force import (
    FedForward,
    ForceConfig,
    NoiseEstimatorConfig,
)
from multicontact_control.config.robot import RobotConfig, ToolConfig
from multicontact_control.config.supervision import LimitsConfig

__all__ = [
    'Config',
    'ControllerConfig',
    'FedForward',
    'ForceConfig',
    'LimitsConfig',
    'MAX_DELAY_PERIODS',
    'NoiseEstimatorConfig',
    'RobotConfig',
    'ToolConfig',
    'UnitVector3',
    'Vector',
    'Vector3',
    'merge',
    'parameter',
    'read_parameters',
    'read_yaml',
    'validate',
]
