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
    setup, faults = resolve('quick', plant=plant, seed=seed), list(faults)
    while faults:
        graph_folder, safe = folder / f'{plant}-{len(faults):03d}', False
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
                    yield FaultRow(
                        'ended',
                        'graph',
                        seed,
                        'none',
                        0.0,
                        0.0,
                        0.0,
                        safe,
                        plant,
                        '',
                        problems,
                    )
        finally:
            if safe:  # bags and logs stay where something was not
                shutil.rmtree(graph_folder)


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
    random, rows, problems = np.random.default_rng(options.seed), [], []
    options.out.mkdir(parents=True)
    try:
        for plant in options.plants:
            chosen = random.permutation(list(GRAPH_FAULTS.values()))[: options.count]
            rows.extend(
                track(
                    run_faults(plant, chosen, options.seed, options.out),
                    plant,
                    len(chosen) + 1,
                )
            )
    except (RunError, KeyboardInterrupt) as error:
        problems.append(f'ended early: {error or "interrupted"}')
    rows_as_json = replace_nonfinite_numbers([asdict(row) for row in rows])
    replace_json_file(options.out / 'faults.json', rows_as_json)
    if rows:
        print(
            pd.DataFrame(rows)
            .groupby(['input', 'kind'])
            .agg(
                n=('safe', 'size'),
                reaction=('reaction', lambda x: ', '.join(sorted(set(x)))),
                safe_s=('time_to_safe_s', 'max'),
                force_n=('peak_force_n', 'max'),
                torque=('peak_torque_fraction', 'max'),
                safe=('safe', 'all'),
            )
            .to_string()
        )
    problems += [
        f'not safe: {row.plant}, {row.input} {row.kind}, seed {row.seed}: {row.problems}'
        for row in rows
        if not row.safe
    ]
    print(*problems, sep='\n')
    return 1 if problems else 0


if __name__ == '__main__':
    sys.exit(main())
