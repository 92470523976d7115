"""The robot behind the topics, or its simulator: whether it is there, and what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import time
from typing import Any

from multicontact_control.nodes import qos, topics
from multicontact_control.nodes.graph import ignore_message, take_message
from multicontact_control.nodes.link import ServiceClientNode

OURS = (topics.CONTROLLER, topics.ESTIMATOR, topics.RECORDER)
UNNAMED = '_NODE_NAME_UNKNOWN_'  # of a topic's end, until its node is known, too


@dataclass(frozen=True)
class Robot:
    """What is expected behind the topics, and for how long."""

    joint_names: Sequence[str]  # that it has, among others
    wrench_input: str = (
        'raw'  # which wrench the controller reads: raw, filtered or momentum
    )
    effort_output_topic: str = (
        ''  # that it takes efforts from instead of joint_effort_command
    )
    timeout: float = 12.0  # time without a message after which it counts as gone [s]
    duration: float | None = (
        None  # of the run by its stamps [s]; None until a signal comes
    )


class _Stream:
    """What has come on one topic; of joint states, those without the robot's joints are apart."""

    def __init__(self, subscription: Any, joints: Sequence[str]) -> None:
        self.subscription, self._joints = subscription, joints
        self.newest: Any = None
        self.other: Any = None  # the newest message, if it lacks joints
        self.at = time.monotonic()  # of the newest
        self.publisher = 'the robot'  # its node, once it is known

    def lacking(self, message: Any) -> list[str]:
        return [name for name in self._joints if name not in message.name]

    def poll(self) -> None:
        while (taken := take_message(self.subscription)) is not None:
            if self.lacking(taken[0]):
                self.other = taken[0]
                continue
            self.newest, self.other, self.at = taken[0], None, time.monotonic()


class RobotWatch(ServiceClientNode):
    """Listens to the topics of a `robot`."""

    def __init__(self, domain_id: int, namespace: str, robot: Robot) -> None:
        super().__init__('robot_watch', domain_id, namespace)
        self._robot = robot
        self._streams = {
            topic: _Stream(
                self.node.create_subscription(
                    topic.message,
                    topic.name,
                    ignore_message,
                    qos.make_profile(100, reliable=False),
                ),
                robot.joint_names if topic is topics.JOINT_STATES else (),
            )
            for topic in (topics.JOINT_STATES, topics.WRENCHES.get(robot.wrench_input))
            if topic
        }

    def poll(self) -> None:
        """Take what has come."""
        for topic, stream in self._streams.items():
            stream.poll()
            if (
                stream.newest
                and stream.publisher == 'the robot'
                and (names := self._publishers(topic))
            ):
                stream.publisher = names

    def _full(self, name: str) -> str:
        return self.node.resolve_topic_name(name)

    def _publishers(self, topic: topics.Topic) -> str:
        """Return the names of the nodes that publish a topic, as far as they are known yet."""
        endpoints = self.node.get_publishers_info_by_topic(self._full(topic.name))
        return ', '.join(sorted({info.node_name for info in endpoints} - {UNNAMED}))

    def missing(self) -> str:
        """Return what is missing of the robot and from whom, in one line; empty if nothing is."""
        self.poll()
        lines = [
            self._missing_of(topic, stream) for topic, stream in self._streams.items()
        ]
        efforts = [
            self._full(name)
            for name in (topics.EFFORT_COMMAND.name, self._robot.effort_output_topic)
            if name
        ]
        readers = {
            info.node_name
            for name in efforts
            for info in self.node.get_subscriptions_info_by_topic(name)
        }
        if not readers - {*OURS, UNNAMED}:
            lines.append(
                f'a subscriber of {" or ".join(efforts)} (the robot is to apply these '
                'efforts)'
            )
        return '; '.join(filter(None, lines))

    def _missing_of(self, topic: topics.Topic, stream: _Stream) -> str:
        name = self._full(topic.name)
        if stream.newest is not None:
            return ''
        if stream.other is not None:
            return (
                f'the joints {", ".join(stream.lacking(stream.other))} in {name}, which has '
                f'{", ".join(stream.other.name) or "no names"}'
            )
        if publishers := self._publishers(topic):
            return f'{name} from {publishers}, which publishes nothing yet'
        return f'{name} ({topic.type_name}) from the robot: it has no publisher'

    def silent(self) -> str:
        """Return which topic has not come for the robot's `timeout`, and from whom, or empty."""
        self.poll()
        for topic, stream in self._streams.items():
            age = time.monotonic() - stream.at
            if age > self._robot.timeout:
                of = '' if stream.other is None else ' of its joints'
                return (
                    f'{stream.publisher} has not published {self._full(topic.name)}{of} for '
                    f'{age:.1f} s'
                )
        return ''

    @property
    def sources(self) -> str:
        """Say which nodes publish the robot's topics."""
        return ', '.join(
            f'{self._full(topic.name)} from {stream.publisher}'
            for topic, stream in self._streams.items()
        )
