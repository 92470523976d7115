"""A node of the test's own, and other processes to talk to."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any, TypeVar

from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.node_process import start_node
from multicontact_control.experiment.graph.spec import START_ORDER
from multicontact_control.nodes.link import GuestNode
from multicontact_control.nodes.recorder_node import Bag
from multicontact_control.nodes.topics import Topic
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores

T = TypeVar('T')

ROOT = Path(__file__).resolve().parents[1]
# s, that any test waits for anything: so long that only what never comes is missed.
PATIENCE = float(os.environ.get('MULTICONTACT_TEST_PATIENCE', '180'))
END_TIMEOUT = 10.0  # s, for a node that is terminated after its test

GRAPH = """
import json, sys
from pathlib import Path
from multicontact_control.experiment.graph.run import GraphSpec, run_graph
from multicontact_control.experiment.scenario import resolve
spec = json.loads(sys.argv[1])
folder, ticks, rate = Path(spec.pop('out')), spec['ticks'], 500.0
setup = resolve('quick', plant='rigid', seed=spec.get('seed', 0),
                **({'duration': ticks / rate} if ticks else {}))
config = folder / 'config'
setup.write(config)
run_graph(GraphSpec(
    out=folder, rate=rate, **{'speed': 0.0, **spec},
    reference_file=config / 'reference.yaml' if ticks else None,
    parameter_files={'controller_node': config / 'controller.yaml',
                     'sim_node': config / 'plant.yaml',
                     'noise_estimator_node': config / 'noise_estimator.yaml'}))
"""


@contextmanager
def own_domain() -> Iterator[int]:
    """Reserve a domain that nothing else on this machine uses."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with reserve_domain() as number:
        yield number


def start_graph(
    folder: Path, domain_id: int, *, namespace: str = 'arm', ticks: int = 0, **spec: Any,
) -> subprocess.Popen[str]:
    """
    Start the rigid plant's graph, as fast as it goes, in a process of its own.

    With `ticks` it follows the scenario quick for so long; otherwise it obeys commands until it
    is interrupted. `spec` is of `GraphSpec`, as far as json has it.
    """
    arguments = json.dumps({'out': str(folder), 'domain_id': domain_id, 'namespace': namespace,
                            'ticks': ticks, **spec})
    return subprocess.Popen(
        [sys.executable, '-c', GRAPH, arguments], cwd=ROOT, stderr=subprocess.PIPE, text=True)


def start_command(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    """Start `multicontact` in a process of its own; what it writes goes to pipes."""
    return subprocess.Popen(
        [sys.executable, '-m', 'multicontact_control.cli', *map(str, arguments)], **{
            'cwd': ROOT, 'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE, 'text': True,
            **options})


def node_processes(folder: Path) -> dict[str, int]:
    """Return the processes of a run in a folder, by node name, as `ps` lists them."""
    listed = subprocess.run(['ps', '-ewwo', 'pid=,args='], capture_output=True, text=True).stdout
    return {command: int(pid) for pid, command, *rest in map(str.split, listed.splitlines())
            if rest == [str(folder)] and command in START_ORDER}


def recorded(bag: Path, topic: str) -> list[Any]:
    """Return the messages of one topic of a bag."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(bag) as reader:
        connections = [x for x in reader.connections if x.topic == f'/{topic.lstrip("/")}']
        return [store.deserialize_cdr(data, connection.msgtype)
                for connection, _, data in reader.messages(connections)]


def write_bag(folder: Path, rows: Iterable[tuple[Topic, int, Any]]) -> None:
    """Write a bag of messages, each with its topic and its time [ns]."""
    connections = {}
    with closing(Bag(folder)) as bag:
        for topic, time_ns, message in rows:
            if topic.name not in connections:
                connections[topic.name] = bag.add_topic(
                    f'/{topic.name}', topic.type_name, topic.profile)
            bag.write(connections[topic.name], time_ns, serialize_message(message))


@contextmanager
def obedient_graph(folder: Path, domain_id: int, **spec: Any) -> Iterator[None]:
    """Run a graph that obeys commands; it must end well when it is interrupted."""
    run = start_graph(folder, domain_id, **spec)
    try:
        yield
    finally:
        run.send_signal(signal.SIGINT)
        _, errors = end_of(run)
    assert run.returncode == 0, errors


def wait_for(
    condition: Callable[[], T], what: str, seen: Callable[[], object] | None = None,
) -> T:
    """
    Wait until a condition is true and return its value.

    A slow machine may make an event late, but may not cause its absence. That is an error which
    says what was `seen` instead, or else the condition's last value.
    """
    give_up = time.monotonic() + PATIENCE
    while not (value := condition()):
        if time.monotonic() > give_up:
            raise AssertionError(f'{what}: did not happen within {PATIENCE:g} s; '
                                 f'last seen: {value if seen is None else seen()!r}')
        time.sleep(0.005)
    return value


def end_of(process: subprocess.Popen[str] | StartedNode) -> tuple[str, str]:
    """Wait for the end of a process; return what it wrote to its two pipes."""
    return process.communicate(timeout=PATIENCE)


class StartedNode:
    """A node in a process of its own, as `subprocess.Popen` has it, with what it writes."""

    def __init__(self, module: str, arguments: list[str]) -> None:
        file, name = tempfile.mkstemp()
        os.close(file)
        self.args, self._log = [module, *arguments], Path(name)
        self._process = start_node(module, arguments, os.environ, self._log)
        self.pid = self._process.pid
        self.terminate, self.kill = self._process.terminate, self._process.kill

    def poll(self) -> int | None:
        return self._process.exitcode

    returncode = property(poll)

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def wait(self, timeout: float | None = None) -> None:
        self._process.join(timeout)
        if self.poll() is None:
            raise subprocess.TimeoutExpired(self.args, timeout)

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Wait for its end; return what it wrote to stdout and stderr, twice."""
        self.wait(timeout)
        text = self._log.read_text(encoding='utf-8')
        return text, text


class Middleware:
    """
    One node in the domain of the tests, and the processes that were started there.

    It goes by the name of the simulator, whose place it takes.
    """

    def __init__(self, domain_id: int) -> None:
        self._guest = GuestNode('sim_node', domain_id)
        self.node = self._guest.node
        self._processes: list[StartedNode] = []

    def __enter__(self) -> Middleware:
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._processes:
            process.terminate()  # nothing to one that has ended
        for process in self._processes:
            try:
                output = process.communicate(timeout=END_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()
                output = process.communicate()
            # pytest shows it where the test has failed.
            print(*process.args, f'-> {process.returncode}', *output, sep='\n')
        self._guest.close()

    def start(
        self, module: str, *parameters: str, files: tuple[Path, ...] = (),
        flags: tuple[str, ...] = (),
    ):
        """Start a node of the project in a process of its own."""
        arguments = [*flags, '--ros-args']
        for path in files:
            arguments += ['--params-file', str(path)]
        for parameter in parameters:
            arguments += ['-p', parameter]
        process = StartedNode(module, arguments)
        self._processes.append(process)
        return process

    def pause(self, duration: float = 0.002) -> None:
        """Give the others some time."""
        time.sleep(duration)

    def take(self, subscription, message):
        """Return the newest message of a subscription, None without any."""
        newest = None
        handle = subscription.handle
        with handle:
            while (taken := handle.take_message(message, False)) is not None:
                newest = taken[0]
        return newest


def set_parameter(driver, node_name, name, value):
    """Set a parameter of a node as `ros2 param set` does; return the result."""
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return driver.call(node_name, SetParameters, 'set_parameters', request).results[0]


def get_parameter(driver, node_name, name):
    """Return the value of a parameter of a node."""
    answer = driver.call(
        node_name, GetParameters, 'get_parameters', GetParameters.Request(names=[name]))
    value = parameter_value_to_python(answer.values[0])
    return value if value is None or isinstance(value, (bool, int, float, str)) else list(value)
