"""
The configuration of the controller and the estimator: every tunable value, once.

Each field carries its default, unit, description and range here and nowhere else. The ROS
parameters of the nodes are generated from these models, the YAML files in ``config/`` are ROS 2
parameter files that these models validate, and both report a bad value in the same one line.
"""

from multicontact_control.config.base import (
    Config,
    cross_check,
    parameter,
    Real,
    UnitVector3,
    Vector,
    Vector3,
)
from multicontact_control.config.controller import ControllerConfig, MAX_DELAY_PERIODS
from multicontact_control.config.estimator import NoiseEstimatorConfig
from multicontact_control.config.files import (
    merge,
    read_node_parameters,
    read_parameters,
    read_yaml,
    validate,
    write_parameters,
)
from multicontact_control.config.force import (
    AdaptiveStiffnessConfig,
    FedForward,
    ForceConfig,
    LawName,
)
from multicontact_control.config.law import (
    ContactConfig,
    FrictionConfig,
    MotionConfig,
    SafeBehaviourConfig,
    TransitionConfig,
)
from multicontact_control.config.namespace import check_namespace
from multicontact_control.config.robot import RobotConfig, SensorFrontEndConfig, ToolConfig
from multicontact_control.config.supervision import (
    ContactStateConfig,
    LimitsConfig,
    Reaction,
    WatchdogConfig,
)

__all__ = [
    'AdaptiveStiffnessConfig', 'Config', 'ContactConfig', 'ContactStateConfig',
    'ControllerConfig', 'FedForward', 'ForceConfig', 'FrictionConfig', 'LawName', 'LimitsConfig',
    'MAX_DELAY_PERIODS', 'MotionConfig', 'NoiseEstimatorConfig', 'Reaction', 'Real',
    'RobotConfig', 'SafeBehaviourConfig', 'SensorFrontEndConfig', 'ToolConfig',
    'TransitionConfig', 'UnitVector3', 'Vector', 'Vector3', 'WatchdogConfig', 'check_namespace',
    'cross_check',
    'merge', 'parameter', 'read_node_parameters',
    'read_parameters', 'read_yaml', 'validate', 'write_parameters']
