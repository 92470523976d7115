"""What only the controller's node needs to know, not the controller in it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import sys

from multicontact_control.config import ControllerConfig, parameter, read_yaml, validate
from multicontact_control.control.tasks import ReferenceConfig, ScenarioTask
from multicontact_control.errors import ConfigError
from multicontact_control.nodes.graph import StartupConfig
from multicontact_control.paths import config_dir
from multicontact_control.sensor.push_test import PushTestConfig
from multicontact_control.supervision.command_limits import CommandLimits

SAFE_TIME = 0.5  # s, in which a robot gets the safe behaviour before it gets nothing


class ControllerNodeConfig(StartupConfig):
    """Parameters of the node."""

    supervised: bool = parameter(
        True, 'Whether contact states, watchdogs, limits and the last gate are around the control '
        'law; without them it is the law alone, as its claims are measured.')
    lockstep: bool = parameter(
        False, 'Whether to wait for the noise variance of one sample before answering the next.')
    patience: float = parameter(
        1.5, 'Periods after a sample from which the next is waited for no longer: what has come '
        'of it is used, and one period later the tick is taken without it. 0 to wait for ever; '
        'only with supervision, and not in lockstep.', ge=0.0, le=100.0)
    pair_tolerance: float = parameter(
        0.5, 'Largest difference between the stamps of a joint state and a wrench that are taken '
        'for one sample.', unit='periods', ge=0.0, le=0.5)
    reference_file: str = parameter(
        '', 'YAML file of a scenario or its reference; empty to obey the command topics.')
    effort_output_topic: str = parameter(
        '', 'Topic for the bare efforts (std_msgs/Float64MultiArray) that the forward '
        'controllers of ros2_control take; empty for none.')
    command: CommandLimits = CommandLimits()
    push_test: PushTestConfig = PushTestConfig()

    def _misfits(self) -> Iterator[ConfigError]:
        if self.patience and self.patience < 1.0:
            yield ConfigError('patience', '0, or at least 1 period', self.patience)

    @property
    def folder(self) -> Path:
        """Return where relative paths start: at the last parameter file, or the package's own."""
        files = [
            value for option, value in zip(sys.argv, sys.argv[1:]) if option == '--params-file']
        return Path(files[-1]).resolve().parent if files else config_dir()

    def scenario(self, config: ControllerConfig) -> ScenarioTask | None:
        """Return the scenario to follow, None to obey commands; ConfigError if it is a bad one."""
        if not self.reference_file:
            return None
        path = self.folder / self.reference_file
        values = read_yaml(path)  # of a scenario file more than its reference
        reference = validate(ReferenceConfig, values.get('reference', values), str(path))
        return ScenarioTask(reference, config.rate, config.column_names, config.leader_of)
