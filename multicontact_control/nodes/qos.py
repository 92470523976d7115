"""
The quality-of-service profiles of the graph, each with its reason.

All nodes share a machine: a message is lost where a queue is too short for a late reader. What is
recorded is therefore reliable, and the depths say how late a reader may be.
"""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def make_profile(
    depth: int, *, reliable: bool = True, latched: bool = False
) -> QoSProfile:
    """
    Return a profile that keeps the newest messages.

    Parameters
    ----------
    depth
        How many messages wait for a late reader at most.
    reliable
        Whether the sender sends again what the reader has not got, and waits for it if need be.
    latched
        Whether the sender keeps its messages for readers that come later.

    """
    profile = QoSProfile(depth=depth, history=HistoryPolicy.KEEP_LAST)
    profile.reliability = ReliabilityPolicy.RELIABLE
    if not reliable:
        profile.reliability = ReliabilityPolicy.BEST_EFFORT
    profile.durability = DurabilityPolicy.VOLATILE
    if latched:
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    return profile


STREAM = make_profile(5000)
"""Publishers at the control rate, and readers that may lose nothing however late they look: the
recorder (10 s at 500 Hz), and a client of what a controller tells it now and then."""

INPUT = make_profile(10)
"""Readers at the control rate: 20 ms at 500 Hz; what is older than that is of no use to them."""

SENSOR = make_profile(4, reliable=False)
"""The controller's inputs in real time, which drivers often publish best effort: a reader that was
late goes on with the newest. In lockstep, where a loss would stop everything, they are INPUT."""

EVENT = make_profile(10)
"""What is sent now and then, as commands and diagnostics: none may be lost, nor replayed later."""

GLANCE = make_profile(1, reliable=False)
"""Progress displays: only the newest value counts, and the sender must not wait for it."""

LATCHED = make_profile(1, latched=True)
"""Descriptions: a reader that comes late still gets the last one."""
