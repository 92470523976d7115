"""
Wrong joint speeds and unproven wrist sensors: `PYTHONPATH=test python -m campaign.velocities`.

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
from multicontact_control.control.tasks import MotionReading, quintic
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CommandError, RunError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.fault import PROCESS
from multicontact_control.experiment.faults.in_process import Corruptor
from multicontact_control.experiment.faults.vocabulary import faults_of
from multicontact_control.experiment.scenario import resolve
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

FAULTS = {f'{x.input}:{x.kind}': x for x in faults_of(PROCESS).values() if x.from_start}
ARMS = {'puma': ('rigid', {}), 'panda': ('panda/rigid', {}),
        'panda-mujoco': ('panda/rigid', {'engine': 'mujoco'})}
LARGEST = {'rad/s beyond': 0.3, 'N': 20.0, 'mm': 5.0}
FORCE, WAY, BEGIN, SLIDE_TIME = 10.0, 0.05, 150, 1.5  # N, m, tick, s
TICKS, LONG_TICKS = 1500, 5000  # of speeds and of wrenches
Cell = namedtuple('Cell', 'arm commanded push_test fault place', defaults=('', 0))


def command(loop, home):
    """Press on the first contact, and slide along x."""
    moved = quintic((loop.tick - BEGIN) * loop.setup.controller.period, SLIDE_TIME)
    way, twist, acceleration = WAY * np.outer(moved, np.eye(6)[0])
    with suppress(CommandError):
        if not any(loop.control.commanded_forces.values()):
            loop.control.set_forces({loop.setup.controller.contact_names[0]: FORCE})
        loop.control.set_motion(MotionReading(
            home.position_world + way[:3], home.quaternion_xyzw, twist, acceleration))


def run(cell):
    """Return each joint's largest speed, the largest force and way, and the causes named."""
    (plant, engine), fault = ARMS[cell.arm], FAULTS.get(cell.fault)
    setup = resolve('quick', plant=plant, plant_overrides=engine, controller={
        'sensor': {'require_push_test': cell.push_test}})
    robot, causes = RobotModel(setup.controller.robot, setup.urdf_dir), set()
    speeds, forces, places, corrupt = [], [0.0], [], None
    with closing(ClosedLoop(setup, commanded=True)) as loop, suppress(RunError):
        if fault:  # the middle of the share that a place has of random numbers, and a sign
            corruptor, count = Corruptor(fault, fault.random(0), loop), count_of(cell)
            count //= 1 + ('biased' in cell.fault)
            corruptor.choice = np.array([(cell.place % count + 0.5) / count, cell.place // count])
            corrupt = corruptor.corrupt
        home = robot.update(loop.sample.q, loop.sample.qd).pose
        for _ in range(LONG_TICKS if cell.fault.startswith('wrench') else TICKS):
            loop.advance(corrupt)  # RunError: thrown out of all numbers
            if cell.commanded and loop.tick > BEGIN:
                command(loop, home)
            speeds.append(np.abs(loop.plant.arm.qd))
            forces.append(loop.true_forces.max())
            places.append(robot.update(loop.plant.arm.q, loop.sample.qd).pose.position_world)
            causes.update(x.split('_joint')[0].split('_panda')[0] for x in (
                *loop.status.causes, *loop.status.rejected))
    way = np.linalg.norm(np.array(places) - home.position_world, axis=1).max()
    return np.max(speeds, axis=0), max(forces), 1e3 * way, causes - {'recovering', 'latched'}


def count_of(cell):
    """Return how many places and signs a fault has."""
    if 'biased' in cell.fault:
        return 12
    joints = len(resolve('quick', plant=ARMS[cell.arm][0]).controller.robot.joint_names)
    return joints if cell.fault.endswith('_of_one') else 1


def main(arguments=None):
    """Run the cells that were asked for; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--arms', nargs='+', default=list(ARMS), choices=ARMS)
    parser.add_argument('--faults', nargs='+', default=list(FAULTS), choices=FAULTS)
    parser.add_argument('--every', type=int, default=1, help='take only every so many cells')
    options = parser.parse_args(arguments)
    groups = [Cell(*group) for group in product(
        options.arms, (False, True), (True, False), options.faults)]
    todo = [group._replace(place=place) for group in groups if group.fault.startswith('joints') or
            not group.commanded for place in range(count_of(group))][::options.every]
    right = sorted({Cell(*cell[:3]) for cell in todo})
    found = dict(zip((*right, *todo), track(Parallel(2, return_as='generator')(
        delayed(run)(cell) for cell in (*right, *todo)), total=len(right) + len(todo))))
    table, bad = Table('', *Cell._fields[:4], 'n', *LARGEST, 'untold', 'causes', box=None), 0
    for group in groups:
        cells = [found[x] for x in todo if x[:4] == group[:4]]
        if not cells:
            continue
        figures = [max(float((x[0] - found[Cell(*group[:3])][0]).max()) for x in cells),
                   *(max(x[i] for x in cells) for i in (1, 2))]
        judged = 3 if group.fault.startswith('wrench') else 2  # commanded, it is to move
        wrong = any(x > limit for x, limit in list(zip(figures, LARGEST.values()))[:judged])
        bad += wrong
        table.add_row('not safe' * wrong, *map(str, group[:4]), str(len(cells)),
                      *(f'{x:.2f}' for x in figures), str(sum(not x[3] for x in cells)),
                      ', '.join(sorted(set().union(*(x[3] for x in cells)))))
    Console(width=190).print(table)
    return 1 if bad else 0


if __name__ == '__main__':
    sys.exit(main())
