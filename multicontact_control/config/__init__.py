"""
The configuration of the controller and the estimator: every tunable value, once.

Each field declares its default, unit, description and range. The ROS parameters of the nodes are
generated from these models, the YAML files in ``config/`` are ROS 2 parameter files that these
models validate, and both report a bad value in the same one line.
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
from multicontact_control.config.force import FedForward, ForceConfig, NoiseEstimatorConfig
from multicontact_control.config.robot import RobotConfig, ToolConfig
from multicontact_control.config.supervision import (
    ContactStateConfig,
    LimitsConfig,
    WatchdogConfig,
)

__all__ = [
    'Config', 'ContactStateConfig', 'ControllerConfig', 'FedForward', 'ForceConfig',
    'LimitsConfig', 'MAX_DELAY_PERIODS', 'NoiseEstimatorConfig', 'RobotConfig',
    'ToolConfig', 'UnitVector3', 'Vector', 'Vector3', 'WatchdogConfig', 'merge',
    'parameter', 'read_parameters', 'read_yaml', 'validate']
