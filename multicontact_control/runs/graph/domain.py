"""Domain and namespace of a graph."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import fcntl
import os
from pathlib import Path
import re
import tempfile

from multicontact_control.errors import ConfigError, RunError
import psutil

LARGEST_DOMAIN = 101  # whose ports all machines have
# Of the UDP ports that DDS-RTPS gives the participants of a domain (OMG DDSI-RTPS 9.6.1).
PORT_BASE = 7400
PORTS_PER_DOMAIN = 250
FIRST_PARTICIPANT_OFFSET = 10
PORTS_PER_PARTICIPANT = 2
PARTICIPANTS = 32  # that are looked for


@contextlib.contextmanager
def reserve_domain(domain_id: int | None = None) -> Iterator[int]:
    """
    Hold a ROS domain and yield its number; without one, that of the first domain that is free.

    Raises RunError if none from 0 to 101 is free on this machine.
    """
    if domain_id is not None:
        yield domain_id
        return
    for number in range(LARGEST_DOMAIN + 1):
        # Between the choice and the first participant a domain looks free: a lock, which the
        # system frees when this process ends, says it is not.
        name = f'multicontact_control-{os.getuid()}-domain-{number}.lock'
        with (Path(tempfile.gettempdir()) / name).open('w') as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            if not domain_in_use(number):
                yield number
                return
    raise RunError(f'no ROS domain from 0 to {LARGEST_DOMAIN} is free on this machine')


def domain_in_use(domain_id: int) -> bool:
    """
    Return whether a participant of a domain is on this machine.

    It then listens on one of the UDP ports that DDS gives the first participants of the domain.
    """
    first = PORT_BASE + PORTS_PER_DOMAIN * domain_id + FIRST_PARTICIPANT_OFFSET
    behind_last = first + PORTS_PER_PARTICIPANT * PARTICIPANTS
    ports = range(first, behind_last, PORTS_PER_PARTICIPANT)
    for connection in psutil.net_connections('udp'):
        if connection.laddr and connection.laddr.port in ports:
            return True
    return False


def check_namespace(namespace: str) -> str:
    """
    Return a namespace without the slashes around it; ConfigError if ROS does not accept it.

    An empty one stays empty: the topics of the graph are then at the root.
    """
    bare = namespace.strip('/')
    if bare and not re.fullmatch(r'[A-Za-z_]\w*(/[A-Za-z_]\w*)*', bare, re.ASCII):
        raise ConfigError(
            'namespace', 'names of letters, digits and _, joined by /', f"'{namespace}'"
        )
    return bare
