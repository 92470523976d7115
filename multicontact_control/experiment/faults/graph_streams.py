"""What can happen to the messages of a topic on their way: lost, late, changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from multicontact_control.nodes import messages, topics
import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation

HISTORY = 64
PERIOD = 2_000_000  # ns, by which stamps are moved
LATE = 10  # messages by which a delayed stream is late
OLD = 25  # messages by which one that is out of order is
BURST = 10  # messages that come at once
LOSS = 0.3  # share of messages that an intermittent stream loses

INPUTS: Mapping[str, topics.Topic] = {
    'joints': topics.JOINT_STATES, 'wrench': topics.WRENCH, 'variance': topics.NOISE_VARIANCE}
CLOCK = 'clock'  # the stamps of joints and wrench together


@dataclass
class StreamContext:
    """
    What one fault of one stream is made of.

    Attributes
    ----------
    random
        Source of what it does in detail.
    message
        Class of the messages.
    history
        The good messages, serialised, newest last; that which is being passed on is in it.
    begin
        Newest stamp when it began, the same for all streams [ns].
    choice
        Numbers drawn once, uniform over (0, 1).
    kept
        Messages that are held back.
    first
        The first one during the fault, None until it comes.

    """

    random: np.random.Generator
    message: Any
    history: Sequence[bytes]
    begin: int
    choice: Sequence[float]
    kept: list[bytes]
    first: bytes | None = None


Change = Callable[[StreamContext, Any], None]
Pass = Callable[[StreamContext, int, bytes], list[bytes]]


def _ago(context: StreamContext, count: int) -> bytes:
    return context.history[max(-len(context.history), -1 - count)]


def _reordered(context: StreamContext, n: int, data: bytes) -> list[bytes]:
    if n % 2 == 0:
        context.kept.append(data)
        return []
    return [data, context.kept.pop()]


def _burst(context: StreamContext, _n: int, data: bytes) -> list[bytes]:
    context.kept.append(data)
    if len(context.kept) < BURST:
        return []
    out, context.kept[:] = list(context.kept), []
    return out


DELIVERY: Mapping[str, Pass] = {
    'dropped': lambda context, n, data: [],
    'delayed': lambda context, n, data: [_ago(context, LATE)],
    'stuck': lambda context, n, data: [context.first or data],
    'duplicated': lambda context, n, data: [data, data],
    'reordered': _reordered,
    'out_of_order': lambda context, n, data: [data, _ago(context, OLD)],
    'intermittent': lambda context, n, data: (
        [] if context.random.random() < LOSS else [data]),
    'burst': _burst}


def edited(change: Change) -> Pass:
    """Return a fault that changes every message."""
    def passed(context: StreamContext, _n: int, data: bytes) -> list[bytes]:
        message = deserialize_message(data, context.message)
        change(context, message)
        return [serialize_message(message)]
    return passed


def _field(name: str, change: Callable[[StreamContext, Any], Any]) -> Change:
    """Return a change of one list of numbers of a JointState."""
    def apply(context: StreamContext, message: Any) -> None:
        setattr(message, name, change(context, np.array(getattr(message, name))).tolist())
    return apply


def _wrench(change: Callable[[StreamContext, Any], Any]) -> Change:
    def apply(context: StreamContext, message: Any) -> None:
        force, torque = message.wrench.force, message.wrench.torque
        values = change(context, np.array(
            [force.x, force.y, force.z, torque.x, torque.y, torque.z]))
        force.x, force.y, force.z, torque.x, torque.y, torque.z = values.tolist()
    return apply


def _put(number: float) -> Callable[[StreamContext, Any], Any]:
    def change(context: StreamContext, values: Any) -> Any:
        values[int(context.choice[0] * values.size)] = number
        return values
    return change


def _add(size: float) -> Callable[[StreamContext, Any], Any]:
    def change(context: StreamContext, values: Any) -> Any:
        values[int(context.choice[0] * values.size)] += (
            size if context.choice[1] < 0.5 else -size)
        return values
    return change


def _frozen(context: StreamContext, message: Any) -> None:
    """Keep the values of the first message under the stamps of all."""
    if context.first is not None:
        first = deserialize_message(context.first, context.message)
        for name in ('position', 'velocity', 'effort', 'wrench'):
            if hasattr(message, name):
                setattr(message, name, getattr(first, name))


def _turned(context: StreamContext, values: Any) -> Any:
    axis = np.eye(3)[int(3 * context.choice[0])] * (1.0 if context.choice[1] < 0.5 else -1.0)
    rotation = Rotation.from_rotvec(0.5 * np.pi * axis).as_matrix()
    return np.concatenate([rotation @ values[:3], rotation @ values[3:]])


def _named(names: Callable[[list[str]], list[str]]) -> Change:
    def apply(_context: StreamContext, message: Any) -> None:
        message.name = names(list(message.name))
    return apply


def _stamped(warp: Callable[[int, int], int]) -> Change:
    """Return a change of the stamp, from the true one and that when it began [ns]."""
    def apply(context: StreamContext, message: Any) -> None:
        stamp = messages.stamp_to_ns(message.header.stamp)
        message.header.stamp = messages.ns_to_stamp(max(0, warp(stamp, context.begin)))
    return apply


NAN, INF = float('nan'), float('inf')
NAMES: Mapping[str, Change] = {
    'wrong_names': _named(lambda names: [f'other_{name}' for name in names]),
    'missing_name': _named(lambda names: names[:-1]),
    'doubled_name': _named(lambda names: [names[0], *names[:-1]])}
JOINTS: Mapping[str, Change] = {
    **NAMES, 'frozen': _frozen,
    **{f'{kind}_{short}': _field(name, change)
       for short, name in (('q', 'position'), ('qd', 'velocity'))
       for kind, change in (('nan', _put(NAN)), ('infinite', _put(INF)), ('huge', _put(1e30)),
                            ('wrong_count', lambda context, values: values[:-1]))},
    'biased_q': _field('position', _add(0.05)), 'biased_qd': _field('velocity', _add(0.2))}
WRENCHES: Mapping[str, Change] = {
    'frozen': _frozen, **{kind: _wrench(change) for kind, change in (
        ('nan', _put(NAN)), ('infinite', _put(-INF)), ('huge', _put(1e30)),
        ('saturated', _put(200.0)), ('biased', _add(5.0)), ('rotated', _turned),
        ('sign_flipped', lambda context, values: -values),
        ('half', lambda context, values: 0.5 * values))}}
VARIANCES: Mapping[str, Change] = {
    **NAMES, 'frozen': _frozen, **{kind: _field('effort', change) for kind, change in (
        ('nan', _put(NAN)), ('infinite', _put(INF)), ('zero', _put(0.0)),
        ('negative', _put(-1.0)), ('huge', _put(1e30)), ('tiny', _put(1e-30)),
        ('wrong_count', lambda context, values: values[:-1]))}}
STAMPS: Mapping[str, Change] = {
    'backwards': _stamped(lambda stamp, begin: stamp - OLD * PERIOD),
    'restarted': _stamped(lambda stamp, begin: stamp - begin + PERIOD),
    'stands_still': _stamped(lambda stamp, begin: begin),
    'ahead': _stamped(lambda stamp, begin: stamp + 50 * PERIOD),
    'too_fast': _stamped(lambda stamp, begin: begin + 4 * (stamp - begin)),
    'zero': _stamped(lambda stamp, begin: 0)}


def stream_faults() -> dict[str, dict[str, Pass]]:
    """Return all faults of streams by input and kind."""
    return {
        **{source: {**DELIVERY, **{kind: edited(change) for kind, change in changes.items()}}
           for source, changes in (
               ('joints', JOINTS), ('wrench', WRENCHES), ('variance', VARIANCES))},
        CLOCK: {kind: edited(change) for kind, change in STAMPS.items()}}
