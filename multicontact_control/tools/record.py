"""`multicontact record`: any topic of any installed type into a bag, as raw bytes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
import time

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.nodes.bag_writer import BagWriter
from multicontact_control.nodes.message_definitions import message_class
from multicontact_control.nodes.raw_recording import RawRecording
from multicontact_control.nodes.runtime import StopFlag
from multicontact_control.tools.graph_inspector import (
    full_name,
    GraphInspector,
    matching_profile,
    POLL_PERIOD,
)

DEPTH = 1000
DISCOVERY_PERIOD = 0.1


def record(
    topics: Sequence[str], folder: Path, say: Callable[[str], None], *,
    domain_id: int | None = None,
) -> int:
    """
    Record until interrupted.

    Topics are subscribed to as they appear, with the quality of service of their publishers.

    Parameters
    ----------
    topics
        Names; none for all that are not hidden.
    folder
        The bag, to be created.
    say
        Called with a line for each thing that happens.
    domain_id
        ROS domain; that of the environment by default.

    Returns
    -------
    int
        How many messages the bag holds.

    Raises
    ------
    ConfigError
        If the folder exists, or ROS accepts no such name of a topic.
    RunError
        If it cannot be written to.

    """
    stop = StopFlag()
    stop.install()
    if folder.exists():
        raise ConfigError('--output', 'a folder that does not exist yet', str(folder))
    wanted = {full_name(topic) for topic in topics}
    with GraphInspector(domain_id) as onlooker, BagWriter(folder) as writer:
        recording = RawRecording(onlooker.node, writer)
        done: set[str] = set()
        say('Recording... Press Ctrl-C to stop.')
        next_look = time.monotonic()
        while not stop:
            now = time.monotonic()
            if now >= next_look:
                _record_new(onlooker, recording, wanted, done, say)
                next_look = now + DISCOVERY_PERIOD
            recording.drain()
            time.sleep(POLL_PERIOD)
        recording.drain()  # what came before the interrupt; others may publish for ever
        for stream in recording.streams.values():
            if stream.lost:
                say(f"{stream.lost} messages of '{stream.name}' were lost")
    say(f'Recorded {writer.message_count} messages on {len(recording.streams)} topics to '
        f'{folder}')
    return writer.message_count


def _record_new(
    onlooker: GraphInspector, recording: RawRecording, wanted: set[str], done: set[str],
    say: Callable[[str], None],
) -> None:
    """Begin to record what is published, wanted (everything, if nothing is named) and not done."""
    for name in sorted((wanted or set(onlooker.topics())) - done):
        publishers = onlooker.publishers(name)
        if not publishers:
            continue
        done.add(name)
        type_name = publishers[0].topic_type
        try:
            recording.add(
                name, message_class(type_name), type_name, offered=publishers[0].qos_profile,
                requested=matching_profile(publishers, DEPTH), judged=len(publishers) == 1)
        except RunError as error:
            say(f"Not subscribed to topic '{name}': {error}")
        else:
            say(f"Subscribed to topic '{name}'")
