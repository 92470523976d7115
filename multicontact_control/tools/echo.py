"""`multicontact echo` and `multicontact topics`."""

from __future__ import annotations

from collections.abc import Callable
import time

from multicontact_control.errors import RunError
from multicontact_control.nodes.message_definitions import message_class
from multicontact_control.nodes.runtime import StopFlag
from multicontact_control.tools.graph_inspector import (
    DISCOVERY_POLL,
    full_name,
    GraphInspector,
    matching_profile,
    POLL_PERIOD,
)
from multicontact_control.tools.message_text import document, TRUNCATE_LENGTH

DEPTH = 100


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
        If its messages do not have the field.

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
            message, name, _ignore, matching_profile(publishers, DEPTH))
        handle = subscription.handle
        while not stop:
            with handle:
                taken = handle.take_message(message, False)
            if taken is None:
                time.sleep(POLL_PERIOD)
                continue
            write(document(taken[0], field, truncate))
            if once:
                return


def _ignore(_message: object) -> None:
    pass


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
