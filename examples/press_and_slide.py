"""
Press on two surfaces with a running arm, slide along them, and change a force on the way.

In one terminal ``multicontact run --commanded --domain-id 5`` starts a simulated arm; in another
``python examples/press_and_slide.py 5`` commands it. Any other arm behind the topics does as well.
"""

import sys

from multicontact_control.client import ArmState, MultiContactClient

WAY = 0.08  # m, along x
DURATION = 2.0  # s


def describe(state: ArmState) -> str:
    """Return time, force at every contact, and place of an arm, in one line."""
    forces = ', '.join(f'{name} {force:.2f} N' for name, force in state.forces.items())
    x, y, z = state.position_world
    return f'{state.time:6.2f} s: {forces}, at {x:.3f}, {y:.3f}, {z:.3f} m'


def main() -> None:
    """Press with 10 N on each surface, slide there and back, with 15 N on the table on the way."""
    with MultiContactClient(domain_id=int(sys.argv[1])) as arm:
        arm.set_forces({'table': 10.0, 'board': 10.0})
        state = arm.wait_until_reached(force_tolerance=0.5, timeout=30.0)
        print('pressed ', describe(state))
        start = state.position_desired
        arm.move(start + [WAY, 0.0, 0.0], DURATION)
        print('slid    ', describe(arm.read()))
        arm.set_forces({'table': 15.0})  # the board keeps its 10 N
        state = arm.wait_until_reached(force_tolerance=0.5, timeout=30.0)
        print('stronger', describe(state))
        arm.move(start, DURATION)
        print('back    ', describe(arm.read()))
        arm.set_forces({'table': 0.0, 'board': 0.0})
        print('let go, after', arm.read().time, 's')


if __name__ == '__main__':
    main()
