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

LARGEST_DOMAIN = 101
PORT_BASE, PORTS_PER_DOMAIN, FIRST_PARTICIPANT_OFFSET = 7400, 250, 10
PARTICIPANTS, PORTS_PER_PARTICIPANT = 32, 2


@contextlib.contextmanager
def reserve_domain(domain_id: int | None = None) -> Iterator[int]:
    """Hold a ROS domain and yield it: without a number the first that is free; RunError."""
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
    """Return whether a participant listens on a port that DDS gives the first ones of a domain."""
    first = PORT_BASE + PORTS_PER_DOMAIN * domain_id + FIRST_PARTICIPANT_OFFSET
    ports = range(
        first, first + PORTS_PER_PARTICIPANT * PARTICIPANTS, PORTS_PER_PARTICIPANT
    )
    return any(
        end.laddr and end.laddr.port in ports for end in psutil.net_connections('udp')
    )


def check_namespace(namespace: str) -> str:
    """Return a namespace without the slashes around it; ConfigError if ROS does not accept it."""
    bare = namespace.strip('/')
    if bare and not re.fullmatch(r'[A-Za-z_]\w*(/[A-Za-z_]\w*)*', bare, re.ASCII):
        raise ConfigError(
            'namespace', 'names of letters, digits and _, joined by /', f"'{namespace}'"
        )
    return bare
