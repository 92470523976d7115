"""The simulated plant, the controller and the noise estimator in one process."""

import sys

from multicontact_control.nodes.composed_node import run_composed
from multicontact_control.nodes.topics import SIM
from sim_bridge.sim_node import SimNode


def main() -> int:
    """Run all three."""
    return run_composed(SIM, SimNode)


if __name__ == '__main__':
    sys.exit(main())
