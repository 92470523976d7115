"""The robot behind the topics, or its simulator: whether it is there, and what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import time
from typing import Any

from multicontact_control.nodes import qos, topics
from multicontact_control.nodes.graph import ignore_message, take_message
from multicontact_control.nodes.link import ServiceClientNode

OWN_NODES = (topics.CONTROLLER, topics.ESTIMATOR, topics.RECORDER)
UNNAMED = '_NODE_NAME_UNKNOWN_'  # of a topic's end, until its node is known, too
QUEUE_DEPTH = 100  # messages


@dataclass(frozen=True)
class ExpectedRobot:
    """
    What is expected behind the topics of the user's own robot, and for how long.

    The graph then has no simulator; its nodes wait for these topics before they are activated, and
    end the run when they fall silent.
    """

    joint_names: Sequence[str]  # that it has, among others
    wrench_input: str = 'raw'  # that the controller reads: raw, filtered or momentum
    effort_output_topic: str = ''  # that it obeys instead of joint_effort_command
    timeout: float = 12.0  # time without a message after which it counts as gone [s]
    duration: float | None = None  # of the run by its stamps [s]; None for no end


class _InputStream:
    """What has come on one topic of the robot; of joint states, only those with its joints."""

    def __init__(
        self, node: Any, topic: topics.Topic, expected_names: Sequence[str]
    ) -> None:
        self._node = node
        self._topic = topic
        self._expected_names = expected_names
        self._subscription = node.create_subscription(
            topic.message,
            topic.name,
            ignore_message,
            qos.make_profile(QUEUE_DEPTH, reliable=False),
        )
        self._received = False
        self._received_at = time.monotonic()  # when the newest whole message came
        self._incomplete: Any = None  # the newest message, if it lacks joints
        self._source = ''  # names of the nodes that publish it, once they are known
        self.name = node.resolve_topic_name(topic.name)

    @property
    def source(self) -> str:
        """Which node publishes the topic, in words; `the robot` until its name is known."""
        return self._source or 'the robot'

    def take_messages(self) -> None:
        """Take all that has come since the last call; note when the newest whole message did."""
        while True:
            taken = take_message(self._subscription)
            if taken is None:
                break
            message = taken[0]
            if self._missing_joints(message):
                self._incomplete = message
            else:
                self._received = True
                self._received_at = time.monotonic()
                self._incomplete = None
        if self._received and not self._source:
            self._source = self._publisher_names()

    def _missing_joints(self, message: Any) -> list[str]:
        return [name for name in self._expected_names if name not in message.name]

    def _publisher_names(self) -> str:
        """Return the names of the nodes that publish the topic, as far as they are known yet."""
        ends = self._node.get_publishers_info_by_topic(self.name)
        return ', '.join(sorted({end.node_name for end in ends} - {UNNAMED}))

    def describe_missing(self) -> str:
        """
        Return why no whole message has come yet, empty if one has.

        The line tells apart a topic without a publisher, a publisher that is silent, and joint
        states that lack joints.
        """
        if self._received:
            return ''
        if self._incomplete is not None:
            joints = ', '.join(self._missing_joints(self._incomplete))
            names = ', '.join(self._incomplete.name) or 'no names'
            return f'the joints {joints} in {self.name}, which has {names}'
        publishers = self._publisher_names()
        if publishers:
            return f'{self.name} from {publishers}, which publishes nothing yet'
        return (
            f'{self.name} ({self._topic.type_name}) from the robot: it has no publisher'
        )

    def describe_silence(self, timeout: float) -> str:
        """Return that nothing has come for a time [s], and from whom; empty if something has."""
        age = time.monotonic() - self._received_at
        if age <= timeout:
            return ''
        name = self.name
        if self._incomplete is not None:
            name += ' of its joints'
        return f'{self.source} has not published {name} for {age:.1f} s'


class RobotWatch(ServiceClientNode):
    """
    A node that listens to the topics of an expected robot.

    It says what keeps a run from beginning, and later what has fallen silent. It reads the joint
    states, and the wrench that the controller reads, if any.
    """

    def __init__(self, domain_id: int, namespace: str, robot: ExpectedRobot) -> None:
        super().__init__('robot_watch', domain_id, namespace)
        self._robot = robot
        self._streams = [
            _InputStream(self.node, topics.JOINT_STATES, robot.joint_names)
        ]
        wrench = topics.WRENCHES.get(robot.wrench_input)
        if wrench is not None:
            self._streams.append(_InputStream(self.node, wrench, ()))

    def describe_missing(self) -> str:
        """
        Return what is missing of the robot and from whom, in one line; empty if nothing is.

        It needs publishers of its joints and of the wrench, and a subscriber of the efforts.
        """
        lines = []
        for stream in self._streams:
            stream.take_messages()
            lines.append(stream.describe_missing())
        lines.append(self._describe_missing_reader())
        return '; '.join(line for line in lines if line)

    def _describe_missing_reader(self) -> str:
        """Return that no node of the robot reads the efforts, empty if one does."""
        names = [topics.EFFORT_COMMAND.name]
        if self._robot.effort_output_topic:
            names.append(self._robot.effort_output_topic)
        names = [self.node.resolve_topic_name(name) for name in names]
        readers = set()
        for name in names:
            for end in self.node.get_subscriptions_info_by_topic(name):
                readers.add(end.node_name)
        if readers - {*OWN_NODES, UNNAMED}:
            return ''
        return f'a subscriber of {" or ".join(names)} (the robot is to apply these efforts)'

    def describe_silence(self) -> str:
        """
        Return which topic has not come for the robot's `timeout`, and from whom.

        It is empty as long as all of them come.
        """
        for stream in self._streams:
            stream.take_messages()
            silence = stream.describe_silence(self._robot.timeout)
            if silence:
                return silence
        return ''

    @property
    def sources(self) -> str:
        """
        Which nodes publish the robot's topics, as far as they are known, in one line.

        It is told when the run begins, so that a user sees which of several robots was found.
        """
        return ', '.join(
            f'{stream.name} from {stream.source}' for stream in self._streams
        )
