"""`multicontact topic list` and `multicontact topic echo`: what `ros2 topic` writes."""

from __future__ import annotations

from array import array
from importlib import import_module
import os
import sys
import time
from typing import Annotated, Any

from multicontact_control.cli import options
from multicontact_control.cli.exits import errors_in_one_line
from multicontact_control.errors import ConfigError, RunError
import typer
import yaml

NODE = f'_multicontact_{os.getpid()}'  # hidden, as its name begins so
DEPTH = 100
LONGEST = 128  # entries of a list, or letters, that are shown
POLL_PERIOD = 0.005  # s
FIELDS = 'get_fields_and_field_types'  # a method that messages have


def list_topics(
    wait: Annotated[float, typer.Option(
        help='How long to wait for nodes to answer [s].', min=0.0)] = 1.0,
    domain_id: options.DomainId = None,
) -> None:
    """List the topics of a running graph with their types, like `ros2 topic list -t`."""
    with errors_in_one_line():
        from multicontact_control.nodes.link import GuestNode

        with GuestNode(NODE, domain_id) as guest:
            time.sleep(wait)
            for name, types in known_topics(guest.node):
                typer.echo(f'{name} [{", ".join(types)}]')


def echo(
    topic: Annotated[str, typer.Argument(help='Topic, e.g. /contact_forces/measured.')],
    field: Annotated[str, typer.Option(
        help='Show only this field, e.g. `effort` or `header.stamp`.')] = '',
    once: Annotated[bool, typer.Option('--once', help='End after one message.')] = False,
    full_length: Annotated[bool, typer.Option(
        '--full-length', '-f', help='Show lists and strings beyond 128 entries in full.')] = False,
    timeout: Annotated[float, typer.Option(
        help='Longest wait for a publisher [s].', min=0.0)] = 5.0,
    domain_id: options.DomainId = None,
) -> None:
    """
    Print the messages of a topic, like `ros2 topic echo`.

    The type is found from the graph. YAML documents, `---` after each; Ctrl-C ends it. Exit code
    1: the topic has no publisher or its type is not installed; 2: there is no such field.
    """
    with errors_in_one_line():
        from multicontact_control.nodes.graph import full_topic_name, ignore, take
        from multicontact_control.nodes.link import GuestNode
        from multicontact_control.nodes.runtime import StopFlag

        stop = StopFlag()
        stop.install()
        name = full_topic_name('topic', f'/{topic.strip("/")}')
        with GuestNode(NODE, domain_id) as guest:
            publishers = wait_for_publishers(guest.node, name, timeout, stop)
            if not publishers:
                return
            message = message_class(name, publishers)
            pick(message(), field)  # a field that does not exist is refused at once
            subscription = guest.node.create_subscription(
                message, name, ignore, profile_of(publishers))
            while not stop:
                taken = take(subscription)
                if taken is None:
                    time.sleep(POLL_PERIOD)
                    continue
                print(document(taken[0], field, None if full_length else LONGEST), flush=True)
                if once:
                    return


def known_topics(node: Any) -> list[tuple[str, list[str]]]:
    """Return names and types of all topics that are not hidden."""
    return [(name, types) for name, types in sorted(node.get_topic_names_and_types())
            if not any(part.startswith('_') for part in name.split('/'))]


def wait_for_publishers(node: Any, name: str, timeout: float, stop: object) -> list[Any]:
    """Return what publishes a topic, nothing once `stop` is true; RunError after `timeout` [s]."""
    give_up = time.monotonic() + timeout
    while not (found := node.get_publishers_info_by_topic(name)) and not stop:
        if time.monotonic() > give_up:
            known = ', '.join(other for other, _ in known_topics(node))
            raise RunError(
                f'{name}: expected a publisher within {timeout:g} s, found none (topics: '
                f'{known or "none; is ROS_DOMAIN_ID that of the graph?"})')
        time.sleep(POLL_PERIOD)
    return list(found)


def message_class(name: str, publishers: list[Any]) -> Any:
    """Return the class of a topic's messages; RunError without one."""
    types = sorted({info.topic_type for info in publishers})
    if len(types) > 1:
        raise RunError(f'{name}: expected one type, found {", ".join(types)}')
    package, _, message = types[0].partition('/msg/')
    try:
        return getattr(import_module(f'{package}.msg'), message)
    except (ImportError, AttributeError):
        raise RunError(f'{types[0]}: this message type is not installed') from None


def profile_of(publishers: list[Any]) -> Any:
    """Return the best quality of service that all publishers of a topic can give."""
    from multicontact_control.nodes import qos
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    offered = [info.qos_profile for info in publishers]
    return qos.profile(
        DEPTH, reliable=all(x.reliability == ReliabilityPolicy.RELIABLE for x in offered),
        latched=all(x.durability == DurabilityPolicy.TRANSIENT_LOCAL for x in offered))


def document(message: Any, field: str = '', longest: int | None = LONGEST) -> str:
    """Return a message, or a field of it, as text; ConfigError if there is no such field."""
    chosen = pick(message, field)
    if not hasattr(chosen, FIELDS):
        return f'{chosen}\n---'
    text: str = yaml.safe_dump(
        plain(chosen, longest), allow_unicode=True, width=sys.maxsize, sort_keys=False,
        default_flow_style=False)
    return f'{text}---'


def pick(message: Any, field: str) -> Any:
    """Return a field of a message by its dotted path; ConfigError if there is none."""
    for name in filter(None, field.split('.')):
        known: dict[str, str] = getattr(message, FIELDS, dict)()
        if name not in known:
            raise ConfigError(
                '--field', f'one of {", ".join(known) or "no further fields"}', f"'{name}'")
        message = getattr(message, name)
    return message


def plain(value: Any, longest: int | None) -> Any:
    """Return a message, or a value of a field, as YAML has it."""
    import numpy as np

    if hasattr(value, FIELDS):
        return {name: plain(getattr(value, name), longest)
                for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        value = value.decode('latin-1')
    if isinstance(value, str):
        return value if longest is None or len(value) <= longest else f'{value[:longest]}...'
    if isinstance(value, (list, tuple, array, np.ndarray)):
        cut = longest is not None and len(value) > longest
        return [plain(x, longest) for x in value[:longest]] + ['...'] * cut
    return value.item() if isinstance(value, np.generic) else value
