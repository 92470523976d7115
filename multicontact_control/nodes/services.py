"""Every service of the controller, once; those of the life cycle are rclpy's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from std_srvs.srv import SetBool, Trigger


@dataclass(frozen=True)
class Service:
    """
    One service, which answers with `success`, and with words or the reason of a refusal.

    Attributes
    ----------
    name
        Relative to the controller's node.
    kind
        Service class.
    content
        What it does, for the reference (docs/reference).

    """

    name: str
    kind: Any
    content: str

    @property
    def type_name(self) -> str:
        """Return the type as ROS tools write it, e.g. ``std_srvs/srv/Trigger``."""
        package = self.kind.__module__.split('.', 1)[0]
        return f'{package}/srv/{self.kind.__name__}'


TARE = Service(
    'tare', Trigger, 'Takes the present reading of the wrist sensor for its bias; refused while '
    'a contact is under force control, or pressed by a reaction.')
HOLD = Service('hold', SetBool, 'Holds the present pose and forces, or lets go of them.')
RETRY = Service(
    'retry', Trigger, 'Resumes control that waits for an operator (cause `latched`), and seeks '
    'contacts that were given up.')
PUSH_TEST = Service(
    'push_test', Trigger, 'Begins the push test: log, diagnostics and `~/status` say where to '
    'push the tool.')

SERVICES: tuple[Service, ...] = (TARE, HOLD, RETRY, PUSH_TEST)
