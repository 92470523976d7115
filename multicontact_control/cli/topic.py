"""`multicontact topic list`, `echo` and `hz`, like `ros2 topic`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Sized
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from itertools import pairwise
import os
from statistics import fmean, pstdev
import sys
import time
from typing import Annotated, Any

from multicontact_control.cli.options import DomainId
from multicontact_control.errors import ConfigError, RunError
import typer
import yaml

NODE = f'_multicontact_{os.getpid()}'  # the underscore hides it
POLL_PERIOD = 0.005  # s
LINE_PERIOD = 1.0  # s
DEPTH = 100  # messages that wait, of a fifth of a second at 500 Hz

Topic = Annotated[
    str, typer.Argument(metavar='TOPIC', help='E.g. /contact_forces/measured.')
]
Timeout = Annotated[
    float, typer.Option(help='Longest wait for a publisher [s].', min=0.0)
]


def list_topics(
    wait: Annotated[
        float, typer.Option(help='How long to wait for nodes to answer [s].', min=0.0)
    ] = 1.0,
    domain_id: DomainId = None,
) -> None:
    """List the topics of a running graph with their types."""
    from multicontact_control.nodes.link import ServiceClientNode

    with ServiceClientNode(NODE, domain_id) as guest:
        time.sleep(wait)
        for name, types in sorted(guest.node.get_topic_names_and_types()):
            if '/_' not in name:
                typer.echo(f'{name} [{", ".join(types)}]')


def echo(
    topic: Topic,
    field: Annotated[
        str, typer.Option(help='Show only this field, e.g. `effort` or `header.stamp`.')
    ] = '',
    once: Annotated[
        bool, typer.Option('--once', help='End after one message.')
    ] = False,
    timeout: Timeout = 5.0,
    domain_id: DomainId = None,
) -> None:
    """Print the messages of a topic as YAML documents, until Ctrl-C."""
    from multicontact_control.nodes.runtime import collect_stop_signals

    stop = collect_stop_signals()
    with _subscribed(topic, timeout, domain_id, stop) as (kind, subscription):
        document(kind(), field)  # refuses a wrong field before the first message
        while not stop:
            for message, _ in _take_waiting(subscription):
                print(document(message, field), flush=True)
                if once or stop:
                    return
            time.sleep(POLL_PERIOD)


def rate(
    topic: Topic,
    once: Annotated[bool, typer.Option('--once', help='End after one line.')] = False,
    timeout: Timeout = 5.0,
    domain_id: DomainId = None,
) -> None:
    """Print how often messages of a topic arrive, a line each second, until Ctrl-C."""
    from multicontact_control.nodes.runtime import collect_stop_signals

    stop = collect_stop_signals()
    with _subscribed(topic, timeout, domain_id, stop) as (_, subscription):
        arrivals: list[int] = []  # ns; the last of a line begins the next
        due = time.monotonic() + LINE_PERIOD
        while not stop:
            for _, known in _take_waiting(subscription):
                arrivals.append(known['received_timestamp'])
            if time.monotonic() < due:
                time.sleep(POLL_PERIOD)
                continue
            print(describe_rate(arrivals), flush=True)
            if once:
                return
            arrivals = arrivals[-1:]
            due += LINE_PERIOD


def _take_waiting(subscription: Any) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Return the messages that wait, each with what is known of it."""
    from multicontact_control.nodes.graph import take_message

    return iter(partial(take_message, subscription), None)


def describe_rate(arrivals: Sequence[int]) -> str:
    """
    Return how often messages have arrived, in words: rate, least and longest gap, deviation.

    `arrivals` are the times when they did [ns], in their order.
    """
    if len(arrivals) < 2:
        return 'no two messages within a second'
    apart = [1e-6 * (late - early) for early, late in pairwise(arrivals)]  # ms
    return (
        f'{1e3 / fmean(apart):.1f} Hz: {min(apart):.2f} to {max(apart):.2f} ms apart, '
        f'standard deviation {pstdev(apart):.2f} ms, {len(arrivals)} messages'
    )


@contextmanager
def _subscribed(
    topic: str,
    timeout: float,
    domain_id: int | None,
    stop: Sized,
) -> Iterator[tuple[Any, Any]]:
    """Yield the type of a topic's messages, and a subscription as its publisher offers it."""
    from multicontact_control.nodes import graph
    from multicontact_control.nodes.link import ServiceClientNode
    from rclpy.qos import QoSProfile

    name = graph.full_topic_name('topic', f'/{topic.strip("/")}')
    end = time.monotonic() + timeout
    with ServiceClientNode(NODE, domain_id) as guest:
        while True:
            publishers = guest.node.get_publishers_info_by_topic(name)
            if publishers:
                break
            if stop or time.monotonic() > end:
                raise RunError(
                    f'{name}: expected a publisher within {timeout:g} s, got none '
                    '(`multicontact topic list` shows the topics)'
                )
            time.sleep(POLL_PERIOD)
        package, _, kind = publishers[0].topic_type.partition('/msg/')
        try:
            message = getattr(import_module(f'{package}.msg'), kind)
        except (ImportError, AttributeError):
            raise RunError(
                f'{package}/msg/{kind}: this message type is not installed'
            ) from None
        offered = publishers[0].qos_profile
        profile = QoSProfile(
            depth=DEPTH,
            reliability=offered.reliability,
            durability=offered.durability,
        )
        subscription = guest.node.create_subscription(
            message, name, graph.ignore_message, profile
        )
        yield message, subscription


def document(message: Any, field: str = '') -> str:
    """
    Return a message, or a field of it by its dotted path, as YAML, as `ros2 topic` does.

    An empty path stands for the whole message. Raises ConfigError if there is no such field.
    """
    value = _plain(message)
    while field:
        name, _, field = field.partition('.')
        if not isinstance(value, dict):
            raise ConfigError('--field', 'one of no further fields', f"'{name}'")
        if name not in value:
            raise ConfigError('--field', f'one of {", ".join(value)}', f"'{name}'")
        value = value[name]
    text = yaml.safe_dump(value, allow_unicode=True, width=sys.maxsize, sort_keys=False)
    return text.removesuffix('...\n') + '---'


def _plain(value: Any) -> Any:
    """Return a message, or a value of a field, as YAML has it."""
    if hasattr(value, 'get_fields_and_field_types'):
        return {
            name: _plain(getattr(value, name))
            for name in value.get_fields_and_field_types()
        }
    if hasattr(value, 'tolist'):  # of numpy, or an array
        return value.tolist()
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, bytes):
        return value.decode('latin-1')
    return value
