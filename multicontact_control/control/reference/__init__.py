"""What the controller is asked to do: by a scenario, or by a user's commands."""

from multicontact_control.control.reference.commanded import CommandedReference
from multicontact_control.control.reference.scenario import (
    ApproachConfig,
    ForceStepConfig,
    ReferenceConfig,
    ScenarioReference,
    sine_motion,
    SineConfig,
)
from multicontact_control.control.reference.source import Reference, ReferenceSource, TaskSource
from multicontact_control.control.reference.task_arrays import TaskArrays

__all__ = [
    'ApproachConfig', 'CommandedReference', 'ForceStepConfig', 'Reference', 'ReferenceConfig',
    'ReferenceSource', 'ScenarioReference', 'SineConfig', 'TaskArrays', 'TaskSource',
    'sine_motion']
