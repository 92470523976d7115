"""
A run read back: its numbers, its series as arrays, a figure of one's own, and its passes.

``multicontact simulate --scenario quick`` or any other run leaves a folder; then
``python examples/read_a_run.py runs/latest`` prints numbers of it, and draws ``own_figure.png``
into it. Everything there is a file: the recording in ``bag/``, or in ``samples.npz`` of a run in
process; ``summary.json``; and of a run along a path ``passes.csv``.
"""

from pathlib import Path
import sys

from matplotlib.figure import Figure
from multicontact_control.judging.results import load_run
import numpy as np
import pandas as pd


def main(folder: Path) -> None:
    """Print what a run was worth, and draw errors of force over the place along its way."""
    run = load_run(folder)
    data = run.data  # row k of every series is sample k
    print(
        f'{folder}: {run.summary["verdict"]}, {data.ticks} samples at {data.rate:g} Hz'
    )

    error = data.alpha_meas - data.alpha_des  # shape (samples, contacts) [N]
    pressed = data.alpha_des > 0.0
    figure = Figure()
    axes = figure.subplots(len(data.contact_names), sharex=True, squeeze=False)
    for column, name in enumerate(data.contact_names):
        chosen = pressed[:, column]
        deviation = np.sqrt(np.mean(error[chosen, column] ** 2))
        print(
            f'{name}: {deviation:.3f} N rms off over {chosen.sum() / data.rate:.1f} s'
        )
        x = 1e3 * data.position[chosen, 0]
        axes[column, 0].plot(x, error[chosen, column], linewidth=0.5)
        axes[column, 0].set_ylabel(f'error, {name} [N]')
    axes[-1, 0].set_xlabel('x of the operational point [mm]')
    figure.savefig(folder / 'own_figure.png', dpi=130)

    passes = folder / 'passes.csv'
    if passes.exists():
        table = pd.read_csv(passes)
        columns = ['pass', 'contact', 'force_mean_n', 'force_std_n', 'length_m']
        print(table[columns].round(3).to_string(index=False))


if __name__ == '__main__':
    main(Path(sys.argv[1]))
