"""What is shown of a run on the terminal: its progress, then its table and verdict."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from multicontact_control.errors import format_count
from multicontact_control.judging.metrics import describe_unknown_truth
from multicontact_control.judging.run_modes import (
    EXTERNAL_RUN,
    LOCKSTEP,
    REAL_TIME,
    RECORDED,
)
from multicontact_control.judging.verdict import (
    describe_verdict,
    NOT_STABLE,
    SILENT,
    STABLE,
)
from rich import progress
from rich.console import Console
from rich.markup import escape
from rich.table import Table

VERDICT_COLOURS = {STABLE: 'green', NOT_STABLE: 'red', SILENT: 'red'}
OTHER_COLOUR = 'yellow'  # of all other verdicts


class ShownNumber(NamedTuple):
    """
    A number of ``summary.json`` that is shown of each contact.

    Terminal and report have the same rows in the same order, by the table `NUMBERS` below; digits
    are those behind the point.
    """

    key: str
    label: str
    digits: int
    window: str = ''  # of the run that it is of; '': of its largest step, or under load


NUMBERS = (
    ShownNumber('step_rise_63_s', 'step rise 63 % [s]', 3),
    ShownNumber('step_rise_over_design', 'rise over the design', 2),
    ShownNumber('step_overshoot_percent', 'overshoot [%]', 0),
    ShownNumber('step_settling_s', 'settling time [s]', 3),
    ShownNumber('step_steady_error_n', 'steady-state error [N]', 2),
    ShownNumber('true_error_rms_n', 'true error rms [N]', 2, 'rest'),
    ShownNumber('measured_error_rms_n', 'measured error rms [N]', 2, 'rest'),
    ShownNumber('estimate_error_rms_n', 'estimate error rms [N]', 2, 'rest'),
    ShownNumber('noise_variance_median_n2', 'noise variance [N²]', 2, 'rest'),
    ShownNumber('true_error_rms_n', 'true error rms [N]', 2, 'moving'),
    ShownNumber('measured_error_rms_n', 'measured error rms [N]', 2, 'moving'),
    ShownNumber('estimate_error_rms_n', 'estimate error rms [N]', 2, 'moving'),
    ShownNumber('noise_variance_median_n2', 'noise variance [N²]', 2, 'moving'),
    # The controller knows what its sensor says, and that may be 0 N when the force is not.
    ShownNumber('true_losses', 'contact lost [times]', 0),
    ShownNumber('measured_losses', 'lost as measured [times]', 0),
    ShownNumber('controller_losses', 'lost to the controller [times]', 0),
)
ARM_NUMBERS = {
    'moving_position_rms_m': 'motion error {:.5f} m rms',
    'orientation_max_rad': 'orientation error {:.4f} rad at most',
    'max_fraction_of_limit': 'torque {:.0%} of its limit at most',
}

# What a graph may lose, by key of the summary's `timing`.
LOSSES = (
    ('unanswered_samples', 'samples', 'not answered'),
    ('lost_messages', 'messages', 'lost'),
)

# Takes the time into a run [s], the measured forces [N] by contact, and the real-time factor.
ShowProgress = Callable[..., None]


def make_progress_bar(
    *columns: progress.ProgressColumn | str, console: Console | None, **options: Any
) -> progress.Progress:
    """
    Return a bar of some columns, shown where text can move: not in a file or a pipe.

    `options` are those of `rich.progress.Progress`.
    """
    console = console or Console()
    is_plain = console.is_dumb_terminal or console.no_color
    shown = console.is_terminal and not is_plain
    return progress.Progress(*columns, console=console, disable=not shown, **options)


@contextmanager
def show_progress(
    title: str, duration: float | None, console: Console, waiting: str = ''
) -> Iterator[ShowProgress]:
    """
    Show a bar with the live forces for the time of a run.

    Parameters
    ----------
    title
        What runs.
    duration
        Of the run [s]; None if it has no end of its own.
    console
        Where to show it.
    waiting
        What is shown before the first sample.

    Yields
    ------
    ShowProgress
        A function to call with the time into the run [s], the forces [N] by contact, and the
        real-time factor if that is known.

    """
    end = ''
    if duration is not None:
        end = f' / {duration:.1f}'
    with make_progress_bar(
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
            """Move the bar to a time, and put the newest forces beside it."""
            texts = [f'{name} {force:5.1f} N' for name, force in forces.items()]
            if realtime_factor:
                texts.append(f'{realtime_factor:.2f} x real time')
            completed = min(time, duration or time)
            bar.update(task, completed=completed, forces='  '.join(texts))

        yield show
        bar.update(task, forces='')


def make_count_bar(console: Console | None = None) -> progress.Progress:
    """
    Return the bar of a study: what is done, for how long, and how long it will take.

    The speed is estimated over two hours: jobs differ in length, and a shorter time would let the
    end jump to and fro.
    """
    return make_progress_bar(
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


def describe_run(summary: Mapping[str, Any]) -> str:
    """
    Return what a run was, and what its forces are, in one line from its ``summary.json``.

    Plant and seed are named of simulated runs only. Where true forces are not known, the line says
    that numbers are of measured ones.
    """
    parts = [summary['scenario']]
    simulated = summary['mode'] not in (EXTERNAL_RUN, RECORDED)
    if simulated:
        parts.append(f'plant {summary["plant"]}')
    parts.append(summary['noise_estimator'])
    if simulated:
        parts.append(f'seed {summary["seed"]}')
    parts.append(summary['mode'])
    unknown = describe_unknown_truth(summary['without_truth'], summary['contacts'])
    if unknown:
        parts.append(f'{unknown}: forces as measured')
    return ', '.join(parts)


def list_summary_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """
    Return rows of a label and the numbers of the contacts, without rows of unknown ones.

    All cells are texts, `-` for a number that is not known of one contact. The terminal and the
    report show the same rows.
    """
    rows = []
    for number in NUMBERS:
        label = number.label
        if number.window:
            label = f'{number.window}: {label}'
        texts = []
        for numbers in summary['contacts'].values():
            if number.window:
                numbers = numbers[number.window]
            texts.append(_describe_number(numbers.get(number.key), number.digits))
        if set(texts) != {'-'}:
            rows.append([label, *texts])
    return rows


def print_summary(console: Console, summary: Mapping[str, Any], folder: object) -> None:
    """
    Print what a run was, its numbers as far as they are known, verdict, and where it is.

    `folder` is where the results lie, as it is to be shown. The claims follow in a table of their
    own where the scenario is the paper's.
    """
    console.print(describe_run(summary), markup=False)
    table = Table('')
    for name in summary['contacts']:
        table.add_column(name, justify='right')
    for row in list_summary_rows(summary):
        table.add_row(*map(escape, row))
    if table.row_count:
        console.print(table)
    for line in list_verdict_lines(summary, folder):
        console.print(line)
    if summary['claims']:
        print_claims(console, summary['claims'])


def print_claims(console: Console, claims: Sequence[Mapping[str, Any]]) -> None:
    """
    Print what the paper says beside what a run shows, as far as the run can tell.

    Claims are the mappings of ``summary.json``. Of those that one run cannot judge only the number
    is said, and which study judges them.
    """
    judged = [claim for claim in claims if claim['holds'] is not None]
    table = Table('claim of the paper', 'measured', 'expected', '', show_lines=True)
    for claim in judged:
        verdict = '[yellow]differs[/yellow]'
        if claim['holds']:
            verdict = '[green]holds[/green]'
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


def describe_arm(summary: Mapping[str, Any]) -> str:
    """
    Return motion errors and torque of a run, as far as they are known, in one line.

    It is empty of a recording that knows neither; numbers are those under `motion` and `torque` of
    the summary.
    """
    numbers = summary['motion'] | summary['torque']
    texts = []
    for name, form in ARM_NUMBERS.items():
        if numbers[name] is not None:
            texts.append(form.format(numbers[name]))
    return ', '.join(texts)


def list_verdict_lines(summary: Mapping[str, Any], folder: object) -> list[str]:
    """
    Return the lines below the table, with markup.

    They are motion and torque, the verdict with its quality, timing, warnings, and where the
    results are: `folder`.
    """
    colour = VERDICT_COLOURS.get(summary['verdict'], OTHER_COLOUR)
    verdict = _mark_up(describe_verdict(summary), colour)
    lines = [describe_arm(summary), f'{verdict} (judged: {escape(summary["judged"])})']
    if summary['quality']:
        lines.append(escape(summary['quality']))
    lines += _list_timing_lines(summary)
    for remark in summary.get('remarks', ()):
        lines.append(_mark_up(remark, OTHER_COLOUR))
    path = escape(str(folder))
    lines.append(f'results in {path}')
    lines.append(f'replay: multicontact view {path}')
    return lines


def _list_timing_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return how a graph kept up with its rate, and what messages were lost."""
    timing = summary['timing']
    lines = []
    if summary['mode'] == REAL_TIME:
        latency = timing['latency_us'] or {}
        p99 = _describe_number(latency.get('p99'), 0)
        lines.append(
            f'free-running: {timing["deadline_misses"]} of {summary["ticks"]} deadlines '
            f'missed, latency p99 {p99} us'
        )
    elif summary['mode'] == LOCKSTEP and timing.get('realtime_factor'):
        lines.append(f'{timing["realtime_factor"]:.2f} times real time')
    for key, noun, loss in LOSSES:
        if timing.get(key):
            text = f'warning: {format_count(timing[key], noun)} {loss}'
            lines.append(_mark_up(text, OTHER_COLOUR))
    return lines


def _mark_up(text: str, colour: str) -> str:
    return f'[{colour}]{escape(text)}[/{colour}]'


def _describe_number(value: float | None, digits: int) -> str:
    if value is None:
        return '-'
    rounded = round(value, digits) + 0.0  # which leaves no minus before a zero
    return f'{rounded:.{digits}f}'
