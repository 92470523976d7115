"""The faults of the campaign over the graph: what is done to nodes, messages and commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from multicontact_control.experiment.faults.graph_commands import FORCES, MOTIONS, publish_for
from multicontact_control.experiment.faults.graph_session import FaultSession
from multicontact_control.experiment.faults.graph_streams import stream_faults
from multicontact_control.experiment.graph.spec import CONTROLLER, ESTIMATOR, RECORDER, SIM
from multicontact_control.nodes.link import (
    ACTIVATE,
    CLEAN_UP,
    CONFIGURE,
    DEACTIVATE,
)
import numpy as np

HALT = (0.02, 0.2)  # s
OUTAGE = (0.0, 0.5)  # s, from the end of a process to its successor's start
STREAM = (0.1, 0.4)  # s
INACTIVE = (0.1, 0.4)  # s

Inject = Callable[[FaultSession, np.random.Generator, int], None]


@dataclass(frozen=True)
class GraphFault:
    """
    One kind of fault of a running graph.

    Attributes
    ----------
    kind, input
        Name, and what it befalls.
    inject
        Does it, with a source of random details and its seed, and returns when it is over.
    goes_on
        Whether the controller must go on commanding meanwhile.

    """

    kind: str
    input: str  # noqa: A003
    inject: Inject = field(compare=False)
    goes_on: bool = True


def _draw(random: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(random.uniform(*bounds))


def _killed(name: str) -> Inject:
    def inject(session: FaultSession, random: np.random.Generator, _seed: int) -> None:
        session.restart(name, _draw(random, OUTAGE))
    return inject


def _halted(name: str) -> Inject:
    def inject(session: FaultSession, random: np.random.Generator, _seed: int) -> None:
        session.halt(name, _draw(random, HALT))
    return inject


def _led(name: str, *transitions: str) -> Inject:
    """Return a fault that leads a node down; the way up again is the recovery."""
    def inject(session: FaultSession, random: np.random.Generator, _seed: int) -> None:
        session.lead(name, *transitions)
        session.spin(_draw(random, INACTIVE))
    return inject


def _distorted(source: str, kind: str) -> Inject:
    def inject(session: FaultSession, random: np.random.Generator, seed: int) -> None:
        session.distort(source, kind, seed)
        session.spin(_draw(random, STREAM))
        session.undistort()
    return inject


def _commanded(topic: str, kind: str) -> Inject:
    make = (FORCES if topic == 'forces' else MOTIONS)[kind]

    def inject(session: FaultSession, random: np.random.Generator, _seed: int) -> None:
        publish_for(session, topic, make, _draw(random, STREAM))
    return inject


def _nodes() -> list[GraphFault]:
    down_and_up = (DEACTIVATE, ACTIVATE)
    return [
        GraphFault('killed', ESTIMATOR, _killed(ESTIMATOR)),
        GraphFault('killed', CONTROLLER, _killed(CONTROLLER), goes_on=False),
        GraphFault('killed', RECORDER, _killed(RECORDER)),
        GraphFault('halted', ESTIMATOR, _halted(ESTIMATOR)),
        GraphFault('halted', CONTROLLER, _halted(CONTROLLER), goes_on=False),
        GraphFault('halted', RECORDER, _halted(RECORDER)),
        GraphFault('halted', SIM, _halted(SIM), goes_on=False),
        GraphFault('deactivated', ESTIMATOR, _led(ESTIMATOR, DEACTIVATE)),
        GraphFault('deactivated', CONTROLLER, _led(CONTROLLER, DEACTIVATE)),
        GraphFault('reactivated', CONTROLLER, _led(CONTROLLER, *down_and_up, *down_and_up)),
        GraphFault('cleaned_up', ESTIMATOR, _led(
            ESTIMATOR, DEACTIVATE, CLEAN_UP, CONFIGURE)),
        GraphFault('cleaned_up', CONTROLLER, _led(
            CONTROLLER, DEACTIVATE, CLEAN_UP, CONFIGURE), goes_on=False)]


def graph_faults() -> list[GraphFault]:
    """Return all kinds of faults of a graph, in the order of the table."""
    streams = [GraphFault(kind, source, _distorted(source, kind))
               for source, kinds in stream_faults().items() for kind in kinds]
    commands = [GraphFault(kind, f'{topic} command', _commanded(topic, kind))
                for topic, kinds in (('forces', FORCES), ('motion', MOTIONS)) for kind in kinds]
    return _nodes() + streams + commands


def general_kind(fault: GraphFault) -> str:
    """Return what is done, whatever input it is done to; a node is not like another, though."""
    if fault.input not in stream_faults():
        return f'{fault.kind} {fault.input}'
    kind, _, field = fault.kind.rpartition('_')
    return kind if field in ('q', 'qd') else fault.kind


def quick_faults(seed: int) -> list[GraphFault]:
    """Return one fault of every kind: what can befall several inputs befalls one of them."""
    by_kind: dict[str, list[GraphFault]] = {}
    for fault in graph_faults():
        by_kind.setdefault(general_kind(fault), []).append(fault)
    return [faults[(seed + number) % len(faults)]
            for number, faults in enumerate(by_kind.values())]
