"""
Faults over running graphs: `make campaign`, with options in CAMPAIGN_ARGS.

Kills, halts and deactivates nodes, and damages messages, one after the other.
Prints a table and writes `faults.json`. Exit code 1: something was not safe.
"""

import argparse
from dataclasses import asdict
from pathlib import Path
import shutil
import sys
import time

from campaign.graph import Graph
from campaign.graph_faults import GRAPH_FAULTS
from multicontact_control.errors import RunError
from multicontact_control.faults.outcomes import FaultRow
from multicontact_control.files import replace_json_file, replace_nonfinite_numbers
from multicontact_control.runs.graph.domain import reserve_domain
from multicontact_control.runs.scenario import resolve
import numpy as np
import pandas as pd
from rich.progress import track
from sim_bridge.robots import DEFAULT, find_robot


def run_faults(plant, faults, seed, folder):
    """Yield the `FaultRow` of each fault in graphs of a plant, a new one after each unsafe."""
    setup = resolve('quick', plant=plant, seed=seed)
    faults = list(faults)
    while faults:
        graph_folder = folder / f'{plant}-{len(faults):03d}'
        safe = False
        graph_folder.mkdir(parents=True)
        try:
            with (
                reserve_domain() as domain_id,
                Graph(setup, graph_folder, domain_id) as graph,
            ):
                graph.recover()
                safe = True
                while faults and safe:
                    row = graph.break_once(faults.pop(), seed)
                    safe = row.safe
                    yield row
                if safe:
                    problems = ', '.join(graph.end_all())
                    safe = not problems
                    yield row_of_end(plant, seed, problems)
        finally:
            if safe:  # bags and logs stay where something was not
                shutil.rmtree(graph_folder)


def row_of_end(plant, seed, problems):
    """Return the row of a graph that ends after its faults."""
    return FaultRow(
        kind='ended',
        input='graph',
        seed=seed,
        reaction='none',
        time_to_safe_s=0.0,
        peak_force_n=0.0,
        peak_torque_fraction=0.0,
        safe=not problems,
        plant=plant,
        phase='',
        problems=problems,
    )


def join_reactions(reactions):
    """Return the reactions of several rows as a text."""
    return ', '.join(sorted(set(reactions)))


def main(arguments=None):
    """Run the campaign; return the exit code."""
    parser = argparse.ArgumentParser(
        prog='make campaign',
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        '--plants',
        nargs='+',
        default=[*find_robot(DEFAULT).file.plants],
        help='default: %(default)s',
    )
    parser.add_argument('--seed', type=int, default=0, help='of plants and faults')
    parser.add_argument(
        '--count', type=int, help='so many faults of each plant; all by default'
    )
    parser.add_argument(
        '--out',
        type=Path,
        default=Path(time.strftime('runs/campaign-%m%d-%H%M')),
        help='a new folder (%(default)s)',
    )
    options = parser.parse_args(arguments)
    random = np.random.default_rng(options.seed)
    rows, problems = [], []
    options.out.mkdir(parents=True)
    try:
        for plant in options.plants:
            chosen = random.permutation(list(GRAPH_FAULTS.values()))[: options.count]
            results = run_faults(plant, chosen, options.seed, options.out)
            rows.extend(track(results, plant, len(chosen) + 1))
    except (RunError, KeyboardInterrupt) as error:
        problems.append(f'ended early: {error or "interrupted"}')
    rows_as_json = replace_nonfinite_numbers([asdict(row) for row in rows])
    replace_json_file(options.out / 'faults.json', rows_as_json)
    if rows:
        summary = (
            pd.DataFrame(rows)
            .groupby(['input', 'kind'])
            .agg(
                n=('safe', 'size'),
                reaction=('reaction', join_reactions),
                safe_s=('time_to_safe_s', 'max'),
                force_n=('peak_force_n', 'max'),
                torque=('peak_torque_fraction', 'max'),
                safe=('safe', 'all'),
            )
        )
        print(summary.to_string())
    for row in rows:
        if not row.safe:
            problems.append(
                f'not safe: {row.plant}, {row.input} {row.kind}, seed {row.seed}: '
                f'{row.problems}'
            )
    print(*problems, sep='\n')
    return 1 if problems else 0


if __name__ == '__main__':
    sys.exit(main())
