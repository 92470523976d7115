"""Controller and noise estimator in one process, which hand each other their messages."""

from __future__ import annotations

from collections.abc import Callable
import sys
from typing import Any

from multicontact_control.nodes import topics
from multicontact_control.nodes.composition import Composition
from multicontact_control.nodes.controller_node import ControllerNode
from multicontact_control.nodes.local_delivery import LocalDelivery
from multicontact_control.nodes.noise_estimator_node import NoiseEstimatorNode
from multicontact_control.nodes.runtime import run_node


def run_composed(
    plant_name: str = '', make_plant: Callable[[LocalDelivery], Any] | None = None,
) -> int:
    """
    Run controller and noise estimator in this process, and a plant if one is given.

    Each keeps its name, parameters, services and topics: for everybody else nothing is different.

    Parameters
    ----------
    plant_name, make_plant
        Name of the plant's node, and what returns it. It has the process then, otherwise the
        controller does.

    Returns
    -------
    int
        Exit code; see `run_node`.

    """
    def make() -> Composition:
        local = LocalDelivery(filter(None, (topics.CONTROLLER, topics.ESTIMATOR, plant_name)))
        estimator, controller = NoiseEstimatorNode(local), ControllerNode(local)
        if make_plant is None:
            return Composition(controller, [estimator], local)
        return Composition(make_plant(local), [controller, estimator], local)

    return run_node(make)


def main() -> int:
    """Run controller and noise estimator."""
    return run_composed()


if __name__ == '__main__':
    sys.exit(main())
