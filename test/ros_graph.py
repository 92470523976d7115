"""A node of the test's own, and other processes to talk to."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
import os
from pathlib import Path
import subprocess
import sys
import time
from typing import Any, TypeVar

from multicontact_control.nodes.graph import take_message
from multicontact_control.nodes.link import ServiceClientNode
from multicontact_control.nodes.recorder_node import Bag
from multicontact_control.nodes.topics import Topic
from multicontact_control.runs.graph.domain import reserve_domain
from multicontact_control.runs.graph.run import running_graph
from multicontact_control.runs.graph.spec import GraphSpec, START_ORDER
from multicontact_control.runs.scenario import resolve
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores

T = TypeVar('T')

ROOT = Path(__file__).resolve().parents[1]
# s, that any test waits for anything: so long that only what never comes is missed.
PATIENCE = float(os.environ.get('MULTICONTACT_TEST_PATIENCE', '180'))


def start_python(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    """Start Python in a process of its own; what it writes goes to pipes."""
    chosen = {
        'cwd': ROOT,
        'env': {**os.environ, 'PYTHONPATH': str(ROOT)},
        'stdout': subprocess.PIPE,
        'stderr': subprocess.PIPE,
        **options,
    }
    return subprocess.Popen([sys.executable, *map(str, arguments)], text=True, **chosen)


def start_command(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    """Start `multicontact` in a process of its own."""
    return start_python('-m', 'multicontact_control.cli', *arguments, **options)


def node_processes(folder: Path) -> dict[str, int]:
    """Return the processes of a run in a folder, by node name, as `ps` lists them."""
    listed = subprocess.run(
        ['ps', '-ewwo', 'pid=,args='], capture_output=True, text=True
    ).stdout
    processes = {}
    for line in listed.splitlines():
        pid, command, *arguments = line.split()
        if arguments == [str(folder)] and command in START_ORDER:
            processes[command] = int(pid)
    return processes


def recorded(bag: Path, topic: str) -> list[Any]:
    """Return the messages of one topic of a bag."""
    store = get_typestore(Stores.ROS2_JAZZY)
    name = f'/{topic.lstrip("/")}'
    with Reader(bag) as reader:
        connections = [each for each in reader.connections if each.topic == name]
        messages = []
        for connection, _, data in reader.messages(connections):
            messages.append(store.deserialize_cdr(data, connection.msgtype))
    return messages


def write_bag(folder: Path, rows: Iterable[tuple[Topic, int, Any]]) -> None:
    """Write a bag of messages, each with its topic and its time [ns]."""
    connections = {}
    with closing(Bag(folder)) as bag:
        for topic, time_ns, message in rows:
            if topic.name not in connections:
                connections[topic.name] = bag.add_topic(
                    f'/{topic.name}', topic.type_name, topic.profile
                )
            bag.write(connections[topic.name], time_ns, serialize_message(message))


def keep_waiting(what: str) -> None:
    """Wait for the start of a graph without a word."""


@contextmanager
def obedient_graph(
    folder: Path, namespace: str = 'arm', speed: float = 0.0
) -> Iterator[int]:
    """Run the rigid plant's graph, at 0 as fast as it goes; yield its domain."""
    setup = resolve('quick', plant='rigid')
    with reserve_domain() as domain_id:
        spec = GraphSpec(
            out=folder,
            ticks=0,
            rate=500.0,
            speed=speed,
            domain_id=domain_id,
            namespace=namespace,
            parameter_files=setup.write(folder / 'config'),
        )
        with running_graph(spec, keep_waiting) as graph:
            wait_for(graph.progress.read_newest, 'samples')
            yield domain_id
            graph.processes.check_running()


def wait_for(
    condition: Callable[[], T],
    what: str,
    seen: Callable[[], object] | None = None,
) -> T:
    """
    Wait until a condition is true and return its value.

    A slow machine may make an event late, but may not cause its absence. That is an error which
    says what was `seen` instead, or else the condition's last value.
    """
    give_up = time.monotonic() + PATIENCE
    value = condition()
    while not value:
        if time.monotonic() > give_up:
            last = value if seen is None else seen()
            raise AssertionError(
                f'{what}: did not happen within {PATIENCE:g} s; last seen: {last!r}'
            )
        time.sleep(0.005)
        value = condition()
    return value


def end_of(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Wait for the end of a process; return what it wrote to its two pipes."""
    return process.communicate(timeout=PATIENCE)


class Middleware:
    """
    One node in the domain of the tests, and the processes that were started there.

    It goes by the name of the simulator, whose place it takes.
    """

    def __init__(self, domain_id: int) -> None:
        self._guest = ServiceClientNode('sim_node', domain_id)
        self.node = self._guest.node
        self._processes: list[subprocess.Popen[str]] = []
        self._environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain_id)}

    def __enter__(self) -> Middleware:
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._processes:
            process.terminate()  # nothing to one that has ended
        for process in self._processes:
            # pytest shows it where the test has failed.
            print(*process.args, *end_of(process), f'-> {process.returncode}', sep='\n')
        self._guest.close()

    def start(
        self,
        module: str,
        *parameters: str,
        files: tuple[Path, ...] = (),
        flags: tuple[str, ...] = (),
    ) -> subprocess.Popen[str]:
        """Start a node of the project in a process of its own."""
        arguments = [*flags, '--ros-args']
        for path in files:
            arguments += ['--params-file', str(path)]
        for parameter in parameters:
            arguments += ['-p', parameter]
        self._processes.append(
            start_python('-m', module, *arguments, env=self._environment)
        )
        return self._processes[-1]

    def pause(self, duration: float = 0.002) -> None:
        """Give the others some time."""
        time.sleep(duration)

    def take(self, subscription):
        """Return the newest message of a subscription, None without any."""
        newest = None
        while (taken := take_message(subscription)) is not None:
            newest = taken[0]
        return newest
