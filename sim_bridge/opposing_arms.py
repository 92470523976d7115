"""Arms of other graphs that press the same bodies from behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from multicontact_control.config import check_namespace
from multicontact_control.nodes import qos, topics
from multicontact_control.nodes.graph_node import Refusals
from multicontact_control.nodes.raw_messages import effort_reader
from multicontact_control.nodes.streams import Streams
from sim_bridge.config import PlantConfig
from sim_bridge.plant import Plant

SILENCE = 0.1  # s, after which an arm that is not heard any more presses no more


@dataclass
class _Arm:
    """An arm of another graph."""

    pressed: list[tuple[int, int]]  # number of the surface here, and of the contact there
    forces: list[float]
    heard_at: int


class OpposingArms:
    """
    Takes the true forces of other graphs, for the bodies that both arms press.

    Each simulator has a body of its own in its own world, under both forces, and the force from
    behind comes a period or two late. The springs of the two bodies keep them together; with
    v the body's speed they are v times that delay apart.

    Parameters
    ----------
    config, plant
        What is pressed.
    streams, refusals
        The node's.
    rate
        Samples per second [Hz].

    """

    def __init__(
        self, config: PlantConfig, plant: Plant, streams: Streams, refusals: Refusals,
        rate: float,
    ) -> None:
        self._plant, self._refusals = plant, refusals
        self._silence = round(SILENCE * rate)
        self._now = 0
        self._arms: list[_Arm] = []
        names = config.column_names
        arms: dict[str, list[tuple[int, int]]] = {}
        for number, name in enumerate(config.met):
            namespace = check_namespace(config.surfaces[name].opposed_by)
            if namespace:
                arms.setdefault(namespace, []).append((number, names.index(name)))
        for namespace, pressed in arms.items():
            arm = _Arm(pressed, [0.0] * len(names), -self._silence)
            topic = replace(
                topics.TRUE_FORCES, name=f'/{namespace}/{topics.TRUE_FORCES.name}', publisher='')
            streams.subscribe(topic, self._listener(arm, topic, names), qos.NEWEST)
            self._arms.append(arm)

    def _listener(
        self, arm: _Arm, topic: topics.Topic, names: tuple[str, ...],
    ) -> Callable[[bytes], None]:
        reader = effort_reader(names)

        def listen(data: bytes) -> None:
            with self._refusals.guard(topic):
                arm.forces = reader.read(data).values.tolist()
                arm.heard_at = self._now

        return listen

    def press(self, tick: int) -> None:
        """Let them press as they were last heard to, before the plant is advanced to a tick."""
        self._now = tick
        for arm in self._arms:
            heard = tick - arm.heard_at < self._silence
            for surface, contact in arm.pressed:
                self._plant.contacts.oppose(surface, arm.forces[contact] if heard else 0.0)
