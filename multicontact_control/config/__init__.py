"""
The configuration of the controller and the estimator: every tunable value, once.

Each field declares its default, unit, description and range. The ROS parameters of the nodes are
generated from these models, the YAML files in ``config/`` are ROS 2 parameter files that these
models validate, and both report a bad value in the same one line.
"""

from multicontact_control.config.base import (
    Config,
    cross_check,
    merge,
    parameter,
    read_node_parameters,
    read_parameters,
    read_yaml,
    Real,
    UnitVector3,
    validate,
    Vector,
    Vector3,
)
from multicontact_control.config.contact import ContactConfig
from multicontact_control.config.controller import (
    ControllerConfig,
    MAX_DELAY_PERIODS,
    TransitionConfig,
)
from multicontact_control.config.force import (
    AdaptiveStiffnessConfig,
    FedForward,
    ForceConfig,
    LawName,
    NoiseEstimatorConfig,
)
from multicontact_control.config.robot import RobotConfig, SensorFrontEndConfig, ToolConfig
from multicontact_control.config.supervision import (
    ContactStateConfig,
    LimitsConfig,
    WatchdogConfig,
)

__all__ = [
    'AdaptiveStiffnessConfig', 'Config', 'ContactConfig', 'ContactStateConfig',
    'ControllerConfig', 'FedForward', 'ForceConfig', 'LawName', 'LimitsConfig',
    'MAX_DELAY_PERIODS', 'NoiseEstimatorConfig', 'Real', 'RobotConfig', 'SensorFrontEndConfig',
    'ToolConfig', 'TransitionConfig', 'UnitVector3', 'Vector', 'Vector3', 'WatchdogConfig',
    'cross_check', 'merge', 'parameter', 'read_node_parameters', 'read_parameters', 'read_yaml',
    'validate']
