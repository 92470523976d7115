"""Whether somebody else's robot or simulator is there, and what is missing of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
import contextlib
from statistics import median
import time
from typing import Any

from multicontact_control.errors import MessageError
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph import ignore, take
from multicontact_control.nodes.link import GuestNode
import numpy as np

OURS = (topics.CONTROLLER, topics.ESTIMATOR, topics.RECORDER)
HEARD = 100  # samples that are looked at for a rate, and for stamps that make pairs
SILENCE = 2.0  # s without a message, from which on a robot that was heard is silent
NAMELESS = '_NODE_NAME_UNKNOWN_'  # of a topic's end, until its node is known, too
RATE_BAND = 1.5  # rates beyond 1 / this to this times the right one are told


class _Heard:
    """What has come on one topic; of joint states, those of other joints do not count."""

    def __init__(self, subscription: Any, joints: Sequence[str] = ()) -> None:
        self.subscription, self._joints = subscription, joints
        self.stamps: deque[int] = deque(maxlen=HEARD)
        self.newest: Any = None
        self.at = -1.0  # time.monotonic() of the newest, -1 before the first
        self.others: Any = None  # the newest message, if it does not count

    def lacking(self, message: Any) -> list[str]:
        """Return which joints a message lacks."""
        return [name for name in self._joints if name not in message.name]

    def poll(self) -> None:
        while (taken := take(self.subscription)) is not None:
            if self.lacking(taken[0]):
                self.others = taken[0]
                continue
            self.newest, self.others, self.at = taken[0], None, time.monotonic()
            # A stamp that is none is for the controller to refuse and to count.
            with contextlib.suppress(MessageError):
                self.stamps.append(messages.stamp_to_ns(self.newest.header.stamp))


class RobotWatch(GuestNode):
    """
    Listens to a robot's topics.

    Parameters
    ----------
    domain_id, namespace
        Where it is.
    joint_names
        Joints that it is to have.
    rate
        At which it is to publish [Hz].
    wrench
        Topic of the wrist sensor; None for a robot that has none.
    pair_tolerance
        By how much the stamps of a pair of joints and wrench may differ [s].
    effort_output_topic
        Topic that it may take efforts from instead of ``joint_effort_command``; empty for none.

    """

    def __init__(
        self, domain_id: int, namespace: str, *, joint_names: Sequence[str], rate: float,
        wrench: topics.Topic | None = topics.WRENCH, pair_tolerance: float = 0.0,
        effort_output_topic: str = '',
    ) -> None:
        super().__init__('robot_watch', domain_id, namespace)
        self._heard = {topic: _Heard(self.node.create_subscription(
            topic.message, topic.name, ignore, qos.WATCH),
            joint_names if topic is topics.JOINT_STATES else ())
            for topic in (topics.JOINT_STATES, wrench) if topic is not None}
        self._rate, self._wrench = rate, wrench
        self._tolerance = pair_tolerance
        self._efforts = [topics.EFFORT_COMMAND.name, *filter(None, [effort_output_topic])]
        self._publishers: dict[topics.Topic, str] = {}

    def poll(self) -> None:
        """Take what has come."""
        for topic, heard in self._heard.items():
            heard.poll()
            if heard.at >= 0.0 and topic not in self._publishers:
                names = self._names(topic.name)
                if names:
                    self._publishers[topic] = ', '.join(names)

    def _names(self, topic: str) -> list[str]:
        """Return the names of the nodes that publish a topic, as far as they are known yet."""
        return sorted({info.node_name for info in self.node.get_publishers_info_by_topic(
            self.node.resolve_topic_name(topic))} - {NAMELESS})

    def _listeners(self) -> set[str]:
        """Return the names of the nodes that take efforts."""
        return {info.node_name for topic in self._efforts
                for info in self.node.get_subscriptions_info_by_topic(
                    self.node.resolve_topic_name(topic))} - {*OURS, NAMELESS}

    def missing(self) -> str:
        """Return what is missing of the robot and from whom, in one line; empty if nothing is."""
        self.poll()
        lines = [text for topic, heard in self._heard.items()
                 if (text := self._missing_of(topic, heard))]
        if not lines:
            lines = [self._half_told()]
        if not self._listeners():
            names = ' or '.join(self.node.resolve_topic_name(name) for name in self._efforts)
            lines.append(f'a subscriber of {names} (the robot is to apply these efforts)')
        return '; '.join(filter(None, lines))

    def _missing_of(self, topic: topics.Topic, heard: _Heard) -> str:
        name = self.node.resolve_topic_name(topic.name)
        if heard.at >= 0.0 and time.monotonic() - heard.at < SILENCE:
            return ''
        publishers = self._names(topic.name)
        if heard.at >= 0.0:
            return f'{name}, silent for {time.monotonic() - heard.at:.0f} s, from ' + (
                self._publishers.get(topic, 'its publisher'))
        if heard.others is not None:
            return (f'the joints {", ".join(heard.lacking(heard.others))} in joint_states, which '
                    f'has {", ".join(heard.others.name) or "no names"}')
        if publishers:
            return f'{name} from {", ".join(publishers)}, which publishes nothing yet'
        return f'{name} ({topic.type_name}) from the robot: nobody publishes it'

    def _half_told(self) -> str:
        message = self._heard[topics.JOINT_STATES].newest
        if len(message.position) != len(message.name) or len(message.velocity) != len(
                message.name):
            return (f'position and velocity of every joint in joint_states, which has '
                    f'{len(message.name)} names, {len(message.position)} positions and '
                    f'{len(message.velocity)} velocities')
        return ''

    def doubts(self) -> str:
        """Return what would keep the controller from answering samples; empty if nothing."""
        self.poll()
        if any(len(heard.stamps) < HEARD for heard in self._heard.values()):
            return ''
        joints = self._heard[topics.JOINT_STATES]
        if self._wrench is not None:
            wrench = self._heard[self._wrench]
            apart = np.abs(np.subtract.outer(joints.stamps, wrench.stamps)).min() * 1e-9
            if apart > self._tolerance:
                return (f'joint_states and wrench with stamps that differ by at most '
                        f'{1e3 * self._tolerance:g} ms, which never came: the newest are '
                        f'{joints.stamps[-1]} and {wrench.stamps[-1]} ns')
        steps = [after - before for before, after in zip(joints.stamps, list(joints.stamps)[1:])]
        period = median(steps) * 1e-9  # a few may have been lost on the way here
        rate = 1.0 / period if period > 0.0 else 0.0
        if not self._rate / RATE_BAND < rate < self._rate * RATE_BAND:
            return (f'joint_states at {self._rate:g} Hz, the rate of the controller; its stamps '
                    f'come at {rate:.4g} Hz')
        return ''

    def silent(self, longest: float) -> str:
        """Return which topic has not come for more than `longest` [s] and from whom, or empty."""
        self.poll()
        now = time.monotonic()
        for topic, heard in self._heard.items():
            if heard.at >= 0.0 and now - heard.at > longest:
                who = self._publishers.get(topic, 'the robot')
                of = '' if heard.others is None else ' of its joints'
                return (f'{who} has not published {self.node.resolve_topic_name(topic.name)}{of} '
                        f'for {now - heard.at:.1f} s')
        return ''

    @property
    def found(self) -> str:
        """Say whom was found."""
        return ', '.join(f'{self.node.resolve_topic_name(topic.name)} from '
                         f'{self._publishers.get(topic, "the robot")}' for topic in self._heard)

    @property
    def all_named(self) -> bool:
        """Return whether it is known who publishes each topic: a name may come after messages."""
        self.poll()
        return len(self._publishers) == len(self._heard)
