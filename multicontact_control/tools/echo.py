"""`multicontact echo` and `multicontact topics`, which write what `ros2 topic` writes."""

from __future__ import annotations

from array import array
from collections.abc import Callable
import sys
import time
from typing import Any

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.nodes.graph_node import ignore, take
from multicontact_control.nodes.runtime import StopFlag
from multicontact_control.nodes.topics import message_class
from multicontact_control.tools.graph_inspector import (
    DISCOVERY_POLL,
    full_name,
    GraphInspector,
    matching_profile,
    POLL_PERIOD,
)
import numpy as np
import yaml

DEPTH = 100
TRUNCATE_LENGTH = 128
SEPARATOR = '---'


def echo(
    topic: str, write: Callable[[str], None], *, field: str = '', once: bool = False,
    full_length: bool = False, timeout: float = 5.0, domain_id: int | None = None,
) -> None:
    """
    Write the messages of a topic until interrupted.

    Parameters
    ----------
    topic
        Its name; the type is that of its publisher.
    write
        Called with the text of each message.
    field
        Dotted path of a field; empty for the whole message.
    once
        Whether to end after one message.
    full_length
        Whether to show long lists and strings in full.
    timeout
        Longest wait for a publisher [s].
    domain_id
        ROS domain; that of the environment by default.

    Raises
    ------
    RunError
        If nobody publishes the topic, or its type is not installed.
    ConfigError
        If its messages do not have the field, or ROS accepts no such name of a topic.

    """
    stop = StopFlag()
    stop.install()
    name, truncate = full_name(topic), None if full_length else TRUNCATE_LENGTH
    with GraphInspector(domain_id) as onlooker:
        onlooker.wait_for_publisher(name, timeout, stop)
        publishers = onlooker.publishers(name)
        if not publishers:
            return
        types = sorted({info.topic_type for info in publishers})
        if len(types) > 1:
            raise RunError(f'{name}: expected one type, found {", ".join(types)}')
        message = message_class(types[0])
        document(message(), field)  # a field that does not exist is refused at once
        subscription = onlooker.node.create_subscription(
            message, name, ignore, matching_profile(publishers, DEPTH))
        while not stop:
            taken = take(subscription)
            if taken is None:
                time.sleep(POLL_PERIOD)
                continue
            write(document(taken[0], field, truncate))
            if once:
                return


def list_topics(wait: float = 1.0, domain_id: int | None = None) -> list[str]:
    """
    Return the topics of a graph as `ros2 topic list -t` writes them.

    Parameters
    ----------
    wait
        How long to wait for nodes to answer [s].
    domain_id
        ROS domain; that of the environment by default.

    """
    stop = StopFlag()
    stop.install()
    end = time.monotonic() + wait
    with GraphInspector(domain_id) as onlooker:
        while time.monotonic() < end and not stop:
            time.sleep(DISCOVERY_POLL)
        return [f'{name} [{", ".join(types)}]' for name, types in onlooker.topics().items()]


def document(message: Any, field: str = '', truncate: int | None = TRUNCATE_LENGTH) -> str:
    """
    Return one message, or a field of it, as text that ends with the separator.

    Parameters
    ----------
    message
        Any ROS message.
    field
        Dotted path of the field, e.g. ``header.stamp``; empty for all.
    truncate
        Length beyond which lists and strings are cut; None for never.

    Raises
    ------
    ConfigError
        If the message has no such field.

    """
    chosen = pick(message, field)
    if not hasattr(chosen, 'get_fields_and_field_types'):
        return f'{chosen}\n{SEPARATOR}'
    text: str = yaml.safe_dump(
        plain(chosen, truncate), allow_unicode=True, width=sys.maxsize, sort_keys=False,
        default_flow_style=False)
    return f'{text}{SEPARATOR}'


def pick(message: Any, field: str) -> Any:
    """
    Return a field of a message by its dotted path.

    Raises
    ------
    ConfigError
        If there is none.

    """
    for name in filter(None, field.split('.')):
        fields = getattr(message, 'get_fields_and_field_types', None)
        known: dict[str, str] = fields() if fields is not None else {}
        if name not in known:
            raise ConfigError(
                '--field', f'one of {", ".join(known) or "no further fields"}', f"'{name}'")
        message = getattr(message, name)
    return message


def plain(value: Any, truncate: int | None) -> Any:
    """Return a message or a value of a field as what YAML knows."""
    if hasattr(value, 'get_fields_and_field_types'):
        return {name: plain(getattr(value, name), truncate)
                for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        value = value.decode('latin-1')
    if isinstance(value, str):
        cut = truncate is not None and len(value) > truncate
        return f'{value[:truncate]}...' if cut else value
    if isinstance(value, (list, tuple, array, np.ndarray)):
        cut = truncate is not None and len(value) > truncate
        items = [plain(x, truncate) for x in (value[:truncate] if cut else value)]
        return [*items, '...'] if cut else items
    return value.item() if isinstance(value, np.generic) else value
