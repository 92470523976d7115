"""
Wrong joint speeds and unproven wrist sensors: `make velocities`, with options in CAMPAIGN_ARGS.

An arm is commanded (10 N on its first contact and a slide) or not, its push test is required and
not passed, or not; from the first sample on a fault befalls each joint or axis in turn, or all.
Joints may be 0.3 rad/s faster than without it, surfaces bear 20 N, and because of its wrench an
arm that is not commanded may move by less than 5 mm. Exit code 1: it was otherwise.
"""

import argparse
from contextlib import closing, suppress
from itertools import product
import sys
from typing import NamedTuple

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


class Arm(NamedTuple):
    """An arm by its number of joints, its plant, and what is set over that."""

    joints: int
    plant: str
    overrides: dict[str, str]


ARMS = {
    'puma': Arm(6, 'rigid', {}),
    'panda': Arm(7, 'panda/rigid', {}),
    'panda-mujoco': Arm(7, 'panda/rigid', {'engine': 'mujoco'}),
}
FASTER, LARGEST_FORCE, FARTHEST = 0.3, 20.0, 0.005  # rad/s beyond a right run, N, m
FORCE, WAY, BEGIN, SLIDE_TIME = 10.0, 0.05, 150, 1.5  # N, m, tick, s
TICKS, LONG_TICKS = 1500, 5000  # of speeds and of wrenches


class Cell(NamedTuple):
    """One run; without a fault, how it is when all is right."""

    arm: str
    commanded: bool
    push_test: bool
    fault: str = ''
    place: int = 0


def command(loop, home):
    """Press on the first contact, and slide along x."""
    config = loop.setup.controller
    moved = quintic_blend((loop.tick - BEGIN) * config.period, SLIDE_TIME)
    way, twist, acceleration = WAY * np.outer(moved, np.eye(6)[0])
    goal = home.position_world + way[:3]
    motion = MotionReading(goal, home.quaternion_xyzw, twist, acceleration)
    with suppress(CommandError):
        if not any(loop.control.commanded_forces.values()):
            loop.control.set_forces({config.contact_names[0]: FORCE})
        loop.control.set_motion(motion)


def resolve_setup(cell):
    """Return the setup of a cell; what would tell of a wrong wrench first is switched off."""
    arm = ARMS[cell.arm]
    controller = {'sensor': {'require_push_test': cell.push_test}}
    if cell.fault.startswith('wrench'):
        unseen = {'sensor': {'full_scale': []}, 'collision': {'reaction': 'none'}}
        controller = merge(controller, unseen)
    return resolve(
        'quick', plant=arm.plant, plant_overrides=arm.overrides, controller=controller
    )


def make_occurrence(cell, loop):
    """Return the fault of a cell at its place, of which half is the sign."""
    fault = FAULTS[cell.fault]
    occurrence = FaultOccurrence(fault, fault.random_source(0), loop)
    count = len(getattr(loop.inputs(), fault.input)[1])
    # The middle of the share that a place has of random numbers, and a sign.
    share = (cell.place % count + 0.5) / count
    occurrence.choice = np.array([share, cell.place // count])
    return occurrence


def causes_named(loop):
    """Return what the status names, without joints."""
    named = [*loop.status.causes, *loop.status.rejected]
    causes = {cause.split('_joint')[0].split('_panda')[0] for cause in named}
    if loop.control.supervisor.explanations.stray_force():
        causes.add('wrench: stray force')
    return causes


def run(cell):
    """Return each joint's largest speed, the largest force and way, and the causes named."""
    setup = resolve_setup(cell)
    robot = RobotModel(setup.controller.robot, setup.urdf_dir)
    speeds, forces, places = [], [0.0], []
    causes = set()
    corrupt = None
    ticks = LONG_TICKS if cell.fault.startswith('wrench') else TICKS
    # RunError: the arm is thrown out of all numbers.
    with closing(ClosedLoop(setup, commanded=True)) as loop, suppress(RunError):
        if cell.fault:
            corrupt = make_occurrence(cell, loop).corrupt_inputs  # throughout
        home = robot.update(loop.sample.q, loop.sample.qd).pose
        for _ in range(ticks):
            loop.advance(corrupt)
            if cell.commanded and loop.tick > BEGIN:
                command(loop, home)
            pose = robot.update(loop.plant.arm.q, loop.sample.qd).pose
            speeds.append(np.abs(loop.plant.arm.qd))
            forces.append(loop.sample.contact_force.max())
            places.append(pose.position_world)
            causes |= causes_named(loop)
    ways = np.linalg.norm(np.array(places) - home.position_world, axis=1)
    return {
        'speed': np.max(speeds, axis=0),
        'force': max(forces),
        'way': ways.max(),
        'causes': causes,
    }


def count_places(arm, fault):
    """Return in how many places a fault befalls an arm, one after the other."""
    if 'biased' in fault:
        return 12  # six axes, two signs
    if 'of_one' in fault:
        return ARMS[arm].joints
    return 1


def list_cells(arms, faults):
    """Yield the cells of some arms and faults; a wrench is only tried on uncommanded arms."""
    for arm, commanded, push_test in product(arms, (False, True), (True, False)):
        for fault in faults:
            if commanded and not fault.startswith('joints'):
                continue
            for place in range(count_places(arm, fault)):
                yield Cell(arm, commanded, push_test, fault, place)


def judge_row(cell, row, right):
    """Return the row of a cell, beside the run without a fault."""
    source = cell.fault.split(':')[0]
    faster = (row['speed'] - right['speed']).max()
    safe = faster <= FASTER and row['force'] <= LARGEST_FORCE
    if source == 'wrench':
        safe = safe and row['way'] <= FARTHEST
    named = any(cause.startswith(source) for cause in row['causes'])
    return {**cell._asdict(), **row, 'speed': faster, 'safe': safe, 'named': named}


def join_causes(causes):
    """Return the causes of several rows as a text."""
    return ', '.join(sorted(set().union(*causes)))


def main(arguments=None):
    """Run the cells that were asked for; return the exit code."""
    parser = argparse.ArgumentParser(prog='make velocities', description=__doc__)
    parser.add_argument('--arms', nargs='+', default=list(ARMS), choices=ARMS)
    parser.add_argument('--faults', nargs='+', default=list(FAULTS), choices=FAULTS)
    parser.add_argument(
        '--every', type=int, default=1, help='take only every so many cells'
    )
    options = parser.parse_args(arguments)
    cells = list(list_cells(options.arms, options.faults))[:: options.every]
    workers = Parallel(-1, return_as='generator')
    faultless = list(product(options.arms, (False, True), (True, False)))
    right_rows = workers(delayed(run)(Cell(*way)) for way in faultless)
    right = dict(zip(faultless, right_rows))
    results = track(workers(map(delayed(run), cells)), total=len(cells))
    rows = [judge_row(cell, row, right[cell[:3]]) for cell, row in zip(cells, results)]
    table = pd.DataFrame(rows)
    groups = table.groupby(['arm', 'commanded', 'push_test', 'fault'])
    summary = groups.agg(
        n=('place', 'size'),
        speed=('speed', 'max'),
        force=('force', 'max'),
        way=('way', 'max'),
        named=('named', 'sum'),
        safe=('safe', 'all'),
        causes=('causes', join_causes),
    )
    print(summary.to_string())
    return 0 if table.safe.all() else 1


if __name__ == '__main__':
    sys.exit(main())
