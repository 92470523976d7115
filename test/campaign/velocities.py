"""
Wrong joint speeds and unproven wrist sensors: `make velocities`, with options in CAMPAIGN_ARGS.

An arm is commanded (10 N on its first contact and a slide) or not, its push test is required and
not passed, or not; from the first sample on a fault befalls each joint or axis in turn, or all.
Joints may be 0.3 rad/s faster than without it, surfaces bear 20 N, and because of its wrench an
arm that is not commanded may move by less than 5 mm. Exit code 1: it was otherwise.
"""

import argparse
from collections import namedtuple
from contextlib import closing, suppress
from itertools import product
import sys

from joblib import delayed, Parallel
from multicontact_control.algebra import quintic_blend
from multicontact_control.config import merge
from multicontact_control.control.tasks import MotionReading
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CommandError, RunError
from multicontact_control.faults.fault_run import FaultOccurrence
from multicontact_control.faults.vocabulary import FAULTS as EVERY_FAULT
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
import pandas as pd
from rich.progress import track

FAULTS = {f'{x.input}:{x.kind}': x for x in EVERY_FAULT.values() if x.from_start}
ARMS = {
    'puma': (6, 'rigid', {}),
    'panda': (7, 'panda/rigid', {}),
    'panda-mujoco': (7, 'panda/rigid', {'engine': 'mujoco'}),
}
FASTER, LARGEST_FORCE, FARTHEST = 0.3, 20.0, 0.005  # rad/s beyond a right run, N, m
FORCE, WAY, BEGIN, SLIDE_TIME = 10.0, 0.05, 150, 1.5  # N, m, tick, s
TICKS, LONG_TICKS = 1500, 5000  # of speeds and of wrenches
Cell = namedtuple('Cell', 'arm commanded push_test fault place', defaults=('', 0))


def command(loop, home):
    """Press on the first contact, and slide along x."""
    moved = quintic_blend(
        (loop.tick - BEGIN) * loop.setup.controller.period, SLIDE_TIME
    )
    way, twist, acceleration = WAY * np.outer(moved, np.eye(6)[0])
    with suppress(CommandError):
        if not any(loop.control.commanded_forces.values()):
            loop.control.set_forces({loop.setup.controller.contact_names[0]: FORCE})
        loop.control.set_motion(
            MotionReading(
                home.position_world + way[:3], home.quaternion_xyzw, twist, acceleration
            )
        )


def run(cell):
    """Return each joint's largest speed, the largest force and way, and the causes named."""
    (_, plant, engine), fault = ARMS[cell.arm], FAULTS.get(cell.fault)
    controller = {'sensor': {'require_push_test': cell.push_test}}
    if cell.fault.startswith(
        'wrench'
    ):  # neither full scale nor a collision tells of it
        controller = merge(
            controller,
            {'sensor': {'full_scale': []}, 'collision': {'reaction': 'none'}},
        )
    setup = resolve('quick', plant=plant, plant_overrides=engine, controller=controller)
    robot, causes = RobotModel(setup.controller.robot, setup.urdf_dir), set()
    speeds, forces, places, corrupt = [], [0.0], [], None
    with closing(ClosedLoop(setup, commanded=True)) as loop, suppress(RunError):
        if (
            fault
        ):  # the middle of the share that a place has of random numbers, and a sign
            occurrence = FaultOccurrence(fault, fault.random_source(0), loop)
            count = len(getattr(loop.inputs(), fault.input)[1])
            occurrence.choice = np.array(
                [(cell.place % count + 0.5) / count, cell.place // count]
            )
            corrupt = occurrence.corrupt_inputs  # throughout
        home = robot.update(loop.sample.q, loop.sample.qd).pose
        for _ in range(LONG_TICKS if cell.fault.startswith('wrench') else TICKS):
            loop.advance(corrupt)  # RunError: thrown out of all numbers
            if cell.commanded and loop.tick > BEGIN:
                command(loop, home)
            speeds.append(np.abs(loop.plant.arm.qd))
            forces.append(loop.sample.contact_force.max())
            places.append(
                robot.update(loop.plant.arm.q, loop.sample.qd).pose.position_world
            )
            causes.update(
                x.split('_joint')[0].split('_panda')[0]
                for x in (*loop.status.causes, *loop.status.rejected)
            )
            stray = loop.control.supervisor.explanations.stray_force()
            causes.update(['wrench: stray force'] * bool(stray))
    way = np.linalg.norm(np.array(places) - home.position_world, axis=1).max()
    return {
        'speed': np.max(speeds, axis=0),
        'force': max(forces),
        'way': way,
        'causes': causes,
    }


def main(arguments=None):
    """Run the cells that were asked for; return the exit code."""
    parser = argparse.ArgumentParser(prog='make velocities', description=__doc__)
    parser.add_argument('--arms', nargs='+', default=list(ARMS), choices=ARMS)
    parser.add_argument('--faults', nargs='+', default=list(FAULTS), choices=FAULTS)
    parser.add_argument(
        '--every', type=int, default=1, help='take only every so many cells'
    )
    options = parser.parse_args(arguments)
    ways = [*product(options.arms, (False, True), (True, False))]
    cells = [
        Cell(*way, fault, place)
        for way, fault in product(ways, options.faults)
        if fault.startswith('joints') or not way[1]
        for place in range(
            12 if 'biased' in fault else ARMS[way[0]][0] if 'of_one' in fault else 1
        )
    ]
    cells, workers = cells[:: options.every], Parallel(-1, return_as='generator')
    right = dict(zip(ways, workers(delayed(run)(Cell(*way)) for way in ways)))
    rows = []
    for cell, row in zip(
        cells, track(workers(map(delayed(run), cells)), total=len(cells))
    ):
        source = cell.fault.split(':')[0]
        row['speed'] = (row['speed'] - right[cell[:3]]['speed']).max()
        safe = (
            row['speed'] <= FASTER
            and row['force'] <= LARGEST_FORCE
            and (source != 'wrench' or row['way'] <= FARTHEST)
        )
        named = any(cause.startswith(source) for cause in row['causes'])
        rows.append({**cell._asdict(), **row, 'safe': safe, 'named': named})
    table = pd.DataFrame(rows)
    print(
        table.groupby([*Cell._fields[:4]])
        .agg(
            n=('place', 'size'),
            speed=('speed', 'max'),
            force=('force', 'max'),
            way=('way', 'max'),
            named=('named', 'sum'),
            safe=('safe', 'all'),
            causes=('causes', lambda x: ', '.join(sorted(set().union(*x)))),
        )
        .to_string()
    )
    return 0 if table.safe.all() else 1


if __name__ == '__main__':
    sys.exit(main())
