"""What the controller says on ~/status, as a message and read again; identifiers of commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import secrets
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from sensor_msgs.msg import JointState

STATE, ACCEPTED, REFUSED = 'state', 'accepted', 'refused'
TEXTS = ('event', 'command', 'life_cycle', 'reaction', 'causes', 'contacts', 'push_test')


@dataclass(frozen=True, slots=True)
class ControllerStatus:
    """What the controller says of itself, and of a command."""

    event: str  # `accepted` or `refused` for a command, else `state`
    command: str  # its identifier; empty if it has none
    text: str  # why it is refused; else what the controller does, `ok` for what it is asked for
    life_cycle: str  # `active` or `inactive`
    reaction: str  # `none`, or what it does instead of control
    causes: str
    contacts: str  # the state of each in words
    held: bool  # on command
    refused: int  # commands so far
    readers: int  # of the command's topic that the controller knows, a recorder among them
    push_test: str  # what it asks for; empty for nothing
    forces: Mapping[str, float]  # obeyed by contact and couple [N]; empty in a scenario

    @property
    def contact_states(self) -> dict[str, str]:
        """Return the state of each contact by its name."""
        return dict(each.split(' ', 1) for each in self.contacts.split(', ') if each)

    @classmethod
    def of(cls, message: DiagnosticStatus) -> ControllerStatus:
        """Return what a message on ``~/status`` says."""
        values = {x.key: x.value for x in message.values}
        forces = [each.rsplit(' ', 1) for each in values['forces'].split(', ') if each]
        return cls(text=message.message, refused=int(values['refused']),
                   readers=int(values['readers']), held=values['held'] == str(True),
                   forces={name: float(force) for name, force in forces},
                   **{name: values[name] for name in TEXTS})

    def message(self, name: str, level: bytes) -> DiagnosticStatus:
        """Return the message that says so."""
        values = {each: getattr(self, each) for each in TEXTS} | {
            'refused': str(self.refused), 'readers': str(self.readers), 'held': str(self.held),
            'forces': ', '.join(f'{name} {force:.9g}' for name, force in self.forces.items())}
        return DiagnosticStatus(
            name=name, level=level, message=self.text,
            values=[KeyValue(key=key, value=value) for key, value in values.items()])


def new_identifier() -> str:
    """Return an identifier for a command that no other client uses."""
    return str(1 + secrets.randbelow(2 ** 31 - 1))


def identify(command: Any, identifier: str) -> None:
    """Give a command on a topic an identifier; that of a motion is a number of 31 bits."""
    if isinstance(command, JointState):
        command.header.frame_id = identifier
    else:
        command.time_from_start.sec = int(identifier or 0)


def identifier_of(command: Any) -> str:
    """Return the identifier of a command on a topic, empty if it has none."""
    return str(command.header.frame_id if isinstance(command, JointState)
               else command.time_from_start.sec or '')
