"""
Faults over running graphs: `make campaign`, with options in CAMPAIGN_ARGS.

Kills, halts and deactivates nodes, damages messages and sends wrong commands, one after the other.
Prints a table and writes `faults.json`. Exit code 1: something was not safe.
"""

import argparse
from collections import defaultdict
from dataclasses import asdict
from pathlib import Path
import shutil
import sys
import time

from campaign.graph import Graph
from campaign.graph_faults import GRAPH_FAULTS
from multicontact_control.errors import RunError
from multicontact_control.experiment.display import count_bar
from multicontact_control.experiment.faults.judge import FaultRow
from multicontact_control.experiment.faults.vocabulary import CLOCK, STREAMS
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.scenario import resolve
from multicontact_control.files import write_json
import numpy as np
from rich.console import Console
from rich.table import Table
from sim_bridge.robots import DEFAULT, find_robot


def quick_faults(seed):
    """Return one fault of every kind: what can befall several inputs befalls one of them."""
    by_kind = defaultdict(list)
    for fault in GRAPH_FAULTS.values():
        kind, _, field = fault.kind.rpartition('_')
        kind = kind if field in ('q', 'qd') else fault.kind
        one = '' if fault.input in (*STREAMS, CLOCK) else fault.input  # a node is not like another
        by_kind[kind, one].append(fault)
    return [faults[(seed + number) % len(faults)]
            for number, faults in enumerate(by_kind.values())]


def run_faults(plant, tasks, seed, folder, busy, random=None):
    """
    Yield the `FaultRow` of each fault and seed in graphs of a plant, a new one after each unsafe.

    Adds to `busy` the share of seconds in which the machine was too busy for a graph. With a
    `random`, other forces follow each fault, and the arm rests. RunError if no graph starts.
    """
    setup, tasks, number = resolve('quick', plant=plant, seed=seed), iter(tasks), 0
    task = next(tasks)
    while task is not None:
        number += 1
        graph_folder, safe = folder / f'{plant}-{seed}-{number:03d}', False
        graph_folder.mkdir(parents=True)
        try:
            with reserve_domain() as domain_id, Graph(setup, graph_folder, domain_id) as graph:
                graph.start()
                safe = True
                while task is not None and safe:
                    row = graph.break_once(*task, random)
                    task, safe = next(tasks, None), row.safe
                    yield row
                busy.append(graph.busy())
                if safe:
                    problems = ', '.join(graph.end_all())
                    safe = not problems
                    yield FaultRow('ended', 'graph', seed, 'none', 0.0, 0.0, 0.0, safe, plant, '',
                                   problems)
        finally:
            if safe:  # bags and logs stay where something was not
                shutil.rmtree(graph_folder)


def table_of(rows):
    """Return a line for each kind of fault."""
    table = Table('fault', 'n', 'reaction', 'safe [ms]', 'force [N]', 'torque', 'safe')
    kinds = defaultdict(list)
    for row in rows:
        kinds[f'{row.input} {row.kind}'].append(row)
    for name, found in kinds.items():
        times = [row.time_to_safe_s for row in found]
        table.add_row(
            name, str(len(found)), ', '.join(sorted({row.reaction for row in found})),
            'never' if min(times) < 0.0 else f'{1e3 * max(times):.0f}',
            f'{max(row.peak_force_n for row in found):.1f}',
            f'{max(row.peak_torque_fraction for row in found):.2f}',
            'yes' if all(row.safe for row in found) else 'no')
    return table


def main(arguments=None):
    """Run the campaign; return the exit code."""
    parser = argparse.ArgumentParser(prog='make campaign', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--plants', nargs='+', default=find_robot(DEFAULT).plant_names,
                        help='default: %(default)s')
    parser.add_argument('--seed', type=int, default=0, help='of plants and faults')
    parser.add_argument('--quick', action='store_true',
                        help='one fault of each kind, whatever its input, on the last plant')
    parser.add_argument('--out', type=Path, default=Path(time.strftime('runs/campaign-%m%d-%H%M')),
                        help='a new folder (%(default)s)')
    options = parser.parse_args(arguments)
    plants, seed = options.plants[-1:] if options.quick else options.plants, options.seed
    kinds = quick_faults(seed) if options.quick else list(GRAPH_FAULTS.values())
    tasks = [(fault, seed) for fault in kinds]
    order, console = np.random.default_rng(seed), Console()
    rows, busy, problems = [], [], []
    options.out.mkdir(parents=True)
    try:
        with count_bar(console) as progress:
            bar = progress.add_task('faults', total=len(plants) * (len(tasks) + 1))
            for plant in plants:
                mixed = [tasks[i] for i in order.permutation(len(tasks))]
                for row in run_faults(plant, mixed, seed, options.out, busy):
                    rows.append(row)
                    progress.advance(bar)
    except (RunError, KeyboardInterrupt) as error:
        problems.append(f'ended early: {error or "interrupted"}')
    write_json(options.out / 'faults.json', {
        'busy_share': max(busy, default=0.0), 'faults': [asdict(row) for row in rows]})
    console.print(table_of(rows))
    console.print(f'too busy for real time: {max(busy, default=0.0):.0%} of the seconds')
    problems += [f'not safe: {row.plant}, {row.input} {row.kind}, seed {row.seed}: {row.problems}'
                 for row in rows if not row.safe]
    for problem in problems:
        console.print(problem, style='red', highlight=False)
    return 1 if problems else 0


if __name__ == '__main__':
    sys.exit(main())
