"""What a person sees on the terminal while a run goes on, and after it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from multicontact_control.errors import counted
from multicontact_control.experiment.judge import (
    EXTERNAL_RUN,
    HELD,
    LOCKSTEP,
    NOT_STABLE,
    REAL_TIME,
    RECORDED,
    STABLE,
    UNJUDGED,
    verdict_text,
)
from multicontact_control.experiment.metrics import truth_lacking
from multicontact_control.experiment.results import (
    BAG_FOLDER,
    FIGURE_FOLDER,
    REPORT_FILE,
    SUMMARY_FILE,
)
from multicontact_control.experiment.terminal import CountBar, moving_bar
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

COLOURS = {STABLE: 'green', HELD: 'yellow', UNJUDGED: 'yellow', NOT_STABLE: 'red'}


class ShowProgress(Protocol):
    """Takes the time into a run [s], the measured forces [N] and the real-time factor."""

    def __call__(
        self, time: float, forces: Mapping[str, float], realtime_factor: float = 0.0,
    ) -> None:
        """Show them."""
        ...


@contextmanager
def progress_bar(
    title: str, duration: float | None, console: Console, waiting: str = '',
) -> Iterator[ShowProgress]:
    """Show a bar with the live forces for the time of a run [s], `waiting` before samples come."""
    end = '' if duration is None else f' / {duration:.1f}'
    columns = (TextColumn('{task.description}'), BarColumn(),
               TextColumn(f'{{task.completed:5.1f}}{end} s'), TimeRemainingColumn(),
               TextColumn('{task.fields[forces]}'))
    with moving_bar(*columns, console=console, refresh_per_second=5) as progress:
        task = progress.add_task(title, total=duration, forces=waiting)

        def show(
            time: float, forces: Mapping[str, float], realtime_factor: float = 0.0,
        ) -> None:
            text = '  '.join(f'{name} {force:5.1f} N' for name, force in forces.items())
            if realtime_factor:
                text += f'  {realtime_factor:.2f} x real time'
            progress.update(task, completed=min(time, duration or time), forces=text)

        yield show
        progress.update(task, forces='')


def count_bar(console: Console | None = None) -> Progress:
    """Return the bar of a study: what is done, for how long, and how long it will take."""
    return moving_bar(
        TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TextColumn('left'), TimeRemainingColumn(), console=console, kind=CountBar,
        refresh_per_second=2, speed_estimate_period=7200.0)


def headline(summary: Mapping[str, Any]) -> str:
    """Return what a run was, and what its forces are, in one line."""
    scenario, estimator = summary['scenario'], summary['noise_estimator']
    if summary['mode'] in (EXTERNAL_RUN, RECORDED):
        text = f'{scenario}, {estimator}, {summary["mode"]}'
    else:
        text = (f'{scenario}, plant {summary["plant"]}, {estimator}, seed {summary["seed"]}, '
                f'{summary["mode"]}')
    unknown = truth_lacking(summary['without_truth'], summary['contacts'])
    return text + (f', {unknown}: forces as measured' if unknown else '')


def summary_table(summary: Mapping[str, Any]) -> Table:
    """Return the short table a run ends with."""
    table = Table(title=escape(headline(summary)))
    table.add_column('')
    for name in summary['contacts']:
        table.add_column(name, justify='right')
    contacts = summary['contacts'].values()
    for key, label, digits in (('step_rise_63_s', 'step rise 63 % [s]', 3),
                               ('step_overshoot_percent', 'overshoot [%]', 0)):
        table.add_row(escape(label), *(_number(c[key], digits) for c in contacts))
    without = summary['without_truth']
    left_out = {'true_error_rms_n'} if len(without) == len(contacts) else set()
    left_out |= set() if without else {'measured_error_rms_n'}
    for window in ('rest', 'moving'):
        for key, label, digits in (
                ('true_error_rms_n', 'true error rms [N]', 2),
                ('measured_error_rms_n', 'measured error rms [N]', 2),
                ('estimate_error_rms_n', 'estimate error rms [N]', 2),
                ('noise_variance_median_n2', 'noise variance [N²]', 2),
                ('contact_loss_fraction', 'contact lost [share]', 4)):
            if key not in left_out:
                values = [_number(contact[window][key], digits) for contact in contacts]
                table.add_row(escape(f'{window}: {label}'), *values)
    return table


def verdict_lines(summary: Mapping[str, Any], folder: object) -> list[str]:
    """Return what is said below the table: verdict, warnings, where the results are."""
    motion, torque, timing = summary['motion'], summary['torque'], summary['timing']
    lines = [
        f"motion error {_number(motion['moving_position_rms_m'], 5)} m rms, "
        f"{_number(motion['orientation_max_rad'], 4)} rad at most; torque at most "
        f"{_percent(torque['max_fraction_of_limit'])} of its limit"]
    text = verdict_text(summary)
    colour = COLOURS[HELD if summary['stable'] and text != STABLE else summary['verdict']]
    lines.append(f'[{colour}]{escape(text)}[/{colour}]')
    lines += _timeliness_lines(summary)
    lost = timing.get('lost_messages', 0)
    if lost:
        lines.append(f'[yellow]warning: {lost} messages lost[/yellow]')
    lines += [f'[yellow]{escape(text)}[/yellow]' for text in summary.get('remarks', ())]
    lines.append(f'results in {folder}')
    return lines


def next_lines(folder: Path) -> list[str]:
    """Return what to open next of a run: the pictures, the replay, the numbers."""
    report, bag = folder / REPORT_FILE, folder / BAG_FOLDER
    pictures = report if report.is_file() else folder / FIGURE_FOLDER
    rows = [
        ('figures', str(pictures)),
        ('bag' if bag.is_dir() else 'replay', f'multicontact view {folder}'),
        ('numbers', str(folder / SUMMARY_FILE))]
    return ['open next:', *(f'  {name:<8} {what}' for name, what in rows)]


def _timeliness_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return how real time was kept, as far as it is known."""
    timing, ticks = summary['timing'], summary['ticks']
    unanswered = timing.get('unanswered_samples', 0)
    lines = []
    if summary['mode'] == REAL_TIME:
        misses, p99 = timing['deadline_misses'], (timing['latency_us'] or {}).get('p99')
        lines.append(f'free-running: {misses} of {ticks} deadlines missed, latency p99 '
                     f'{_number(p99, 0)} us')
    elif timing.get('realtime_factor') and summary['mode'] == LOCKSTEP:
        lines.append(f"{timing['realtime_factor']:.2f} times real time")
    if unanswered:
        lines.append(f"[yellow]warning: {counted(unanswered, 'samples')} not answered[/yellow]")
    return lines


def _percent(share: float | None) -> str:
    return '-' if share is None else f'{100.0 * share:.0f} %'


def _number(value: float | None, digits: int) -> str:
    return '-' if value is None else f'{value:.{digits}f}'
