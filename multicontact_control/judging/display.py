"""What is shown of a run on the terminal: its progress, then its table and verdict."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from multicontact_control.errors import format_count
from multicontact_control.judging.metrics import truth_lacking
from multicontact_control.judging.verdict import (
    EXTERNAL_RUN,
    LOCKSTEP,
    NOT_STABLE,
    REAL_TIME,
    RECORDED,
    SILENT,
    STABLE,
    verdict_text,
)
from rich import progress
from rich.console import Console
from rich.markup import escape
from rich.table import Table

COLOURS = {STABLE: 'green', NOT_STABLE: 'red', SILENT: 'red'}
# Of a contact: in a window of the run, or of its largest step and under load; label, and digits.
NUMBERS = (
    ('', 'step_rise_63_s', 'step rise 63 % [s]', 3),
    ('', 'step_rise_over_design', 'rise over the design', 2),
    ('', 'step_overshoot_percent', 'overshoot [%]', 0),
    ('', 'step_settling_s', 'settling time [s]', 3),
    ('', 'step_steady_error_n', 'steady-state error [N]', 2),
    *(
        (window, key, f'{window}: {label}', digits)
        for window in ('rest', 'moving')
        for key, label, digits in (
            ('true_error_rms_n', 'true error rms [N]', 2),
            ('measured_error_rms_n', 'measured error rms [N]', 2),
            ('estimate_error_rms_n', 'estimate error rms [N]', 2),
            ('noise_variance_median_n2', 'noise variance [N²]', 2),
        )
    ),
    # The controller knows what its sensor says, and that may be 0 N when the force is not.
    ('', 'true_losses', 'contact lost [times]', 0),
    ('', 'measured_losses', 'lost as measured [times]', 0),
    ('', 'controller_losses', 'lost to the controller [times]', 0),
)

# Takes the time into a run [s], the measured forces [N] by contact, and the real-time factor.
ShowProgress = Callable[..., None]


def moving_bar(
    *columns: progress.ProgressColumn | str,
    console: Console | None,
    **options: Any,
) -> progress.Progress:
    """Return a bar of some columns, shown where text can move: not in a file or a pipe."""
    console = console or Console()
    lively = (
        console.is_terminal and not console.is_dumb_terminal and not console.no_color
    )
    return progress.Progress(*columns, console=console, disable=not lively, **options)


@contextmanager
def progress_bar(
    title: str,
    duration: float | None,
    console: Console,
    waiting: str = '',
) -> Iterator[ShowProgress]:
    """Show a bar with the live forces for the time of a run [s], `waiting` before samples come."""
    end = '' if duration is None else f' / {duration:.1f}'
    with moving_bar(
        '{task.description}',
        progress.BarColumn(),
        f'{{task.completed:5.1f}}{end} s',
        progress.TimeRemainingColumn(),
        '{task.fields[forces]}',
        console=console,
        refresh_per_second=5,
    ) as bar:
        task = bar.add_task(title, total=duration, forces=waiting)

        def show(
            time: float,
            forces: Mapping[str, float],
            realtime_factor: float = 0.0,
        ) -> None:
            text = '  '.join(f'{name} {force:5.1f} N' for name, force in forces.items())
            if realtime_factor:
                text += f'  {realtime_factor:.2f} x real time'
            bar.update(task, completed=min(time, duration or time), forces=text)

        yield show
        bar.update(task, forces='')


def count_bar(console: Console | None = None) -> progress.Progress:
    """Return the bar of a study: what is done, for how long, and how long it will take."""
    return moving_bar(
        '{task.description}',
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        'left',
        progress.TimeRemainingColumn(),
        console=console,
        refresh_per_second=2,
        speed_estimate_period=7200.0,
    )


def headline(summary: Mapping[str, Any]) -> str:
    """Return what a run was, and what its forces are, in one line."""
    scenario, estimator = summary['scenario'], summary['noise_estimator']
    if summary['mode'] in (EXTERNAL_RUN, RECORDED):
        text = f'{scenario}, {estimator}, {summary["mode"]}'
    else:
        text = (
            f'{scenario}, plant {summary["plant"]}, {estimator}, seed {summary["seed"]}, '
            f'{summary["mode"]}'
        )
    unknown = truth_lacking(summary['without_truth'], summary['contacts'])
    return text + (f', {unknown}: forces as measured' if unknown else '')


def summary_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Return the numbers of the contacts with their labels, as far as they are known."""
    rows = [
        [
            label,
            *(
                _number((contact[window] if window else contact).get(key), digits)
                for contact in summary['contacts'].values()
            ),
        ]
        for window, key, label, digits in NUMBERS
    ]
    return [row for row in rows if {*row[1:]} != {'-'}]


def print_summary(console: Console, summary: Mapping[str, Any], folder: object) -> None:
    """Print what a run was, its numbers as far as they are known, verdict, and where it is."""
    console.print(headline(summary), markup=False)
    table = Table('')
    for name in summary['contacts']:
        table.add_column(name, justify='right')
    for row in summary_rows(summary):
        table.add_row(*map(escape, row))
    if table.row_count:
        console.print(table)
    for line in verdict_lines(summary, folder):
        console.print(line)
    if summary['claims']:
        print_claims(console, summary['claims'])


def print_claims(console: Console, claims: Sequence[Mapping[str, Any]]) -> None:
    """Print what the paper says beside what a run shows, as far as the run can tell."""
    judged = [claim for claim in claims if claim['holds'] is not None]
    table = Table('claim of the paper', 'measured', 'expected', '', show_lines=True)
    for claim in judged:
        verdict = (
            '[green]holds[/green]' if claim['holds'] else '[yellow]differs[/yellow]'
        )
        said = f'{claim["claim"]} ({claim["paper"]})'
        table.add_row(*map(escape, (said, claim['measured'], claim['why'])), verdict)
    if judged:
        # In a narrow terminal cells are wrapped; the console itself wraps nothing.
        console.print(table, soft_wrap=False)
    others = len(claims) - len(judged)
    if others:
        console.print(
            f'{format_count(others, "claims")} not judged by one run: `multicontact study '
            'compare` has the runs that they are about'
        )


def arm_line(summary: Mapping[str, Any]) -> str:
    """Return motion errors and torque of a run, as far as they are known, in one line."""
    numbers = summary['motion'] | summary['torque']
    return ', '.join(
        text.format(numbers[name])
        for name, text in (
            ('moving_position_rms_m', 'motion error {:.5f} m rms'),
            ('orientation_max_rad', 'orientation error {:.4f} rad at most'),
            ('max_fraction_of_limit', 'torque {:.0%} of its limit at most'),
        )
        if numbers[name] is not None
    )


def verdict_lines(summary: Mapping[str, Any], folder: object) -> list[str]:
    """Return the lines below the table: motion, torque, verdict, warnings, where results are."""
    timing, text = summary['timing'], verdict_text(summary)
    colour = COLOURS.get(summary['verdict'], 'yellow')
    lines = [
        arm_line(summary),
        f'[{colour}]{escape(text)}[/{colour}] (judged: {escape(summary["judged"])})',
    ]
    if summary['quality']:
        lines.append(escape(summary['quality']))
    if summary['mode'] == REAL_TIME:
        p99 = (timing['latency_us'] or {}).get('p99')
        lines.append(
            f'free-running: {timing["deadline_misses"]} of {summary["ticks"]} deadlines '
            f'missed, latency p99 {_number(p99, 0)} us'
        )
    elif timing.get('realtime_factor') and summary['mode'] == LOCKSTEP:
        lines.append(f'{timing["realtime_factor"]:.2f} times real time')
    for name, what, event in (
        ('unanswered_samples', 'samples', 'not answered'),
        ('lost_messages', 'messages', 'lost'),
    ):
        if timing.get(name):
            lines.append(
                f'[yellow]warning: {format_count(timing[name], what)} {event}[/yellow]'
            )
    lines += [f'[yellow]{escape(text)}[/yellow]' for text in summary.get('remarks', ())]
    path = escape(str(folder))
    return [*lines, f'results in {path}', f'replay: multicontact view {path}']


def _number(value: float | None, digits: int) -> str:
    if value is None:
        return '-'
    rounded = round(value, digits) + 0.0  # which leaves no minus before a zero
    return f'{rounded:.{digits}f}'
