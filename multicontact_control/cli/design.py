"""`multicontact design`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Annotated, Literal, TYPE_CHECKING

from multicontact_control.choices import LawChoice
from multicontact_control.cli.options import (
    EXIT_FAILED,
    flatten_options,
    is_given,
    Robot,
)
import typer

if TYPE_CHECKING:
    from multicontact_control.commissioning.certified_region import CertifiedLoop
    from multicontact_control.runs.scenario import Setup

PICTURES = ('.png', '.pdf')
Fastest = Literal['time_constant', 'damping_rate']


@dataclass(frozen=True)
class ModelOptions:
    """Options of `design`: the linear model of a contact (P04 eq. 32) that a law is tried on."""

    stiffness: Annotated[
        tuple[float, float],
        typer.Option(metavar='SOFTEST STIFFEST', help='Range of the surfaces [N/m].'),
    ] = (1000.0, 10000.0)
    input_delay: Annotated[
        float, typer.Option(help='T_d, from commanded to acting input [s].')
    ] = 0.006
    noise: Annotated[
        float,
        typer.Option(
            help='R, the variance of the force noise, for which aob and lqg are designed '
            '[N^2].'
        ),
    ] = 0.6
    damping_rate: Annotated[float, typer.Option(help='K_2 [1/s].')] = 100.0
    rate: Annotated[float, typer.Option(help='Control rate [Hz].', min=1.0)] = 500.0


@dataclass(frozen=True)
class CertifyOptions:
    """Options of `design --certify`: whose loop, and what is known of its plant and of R."""

    certify: Annotated[
        bool,
        typer.Option(
            '--certify',
            help='Prove for which surfaces and delays the loop of a preset is stable, however R '
            'changes; with --stiffness, find the fastest loop that is proved there. '
            'Takes minutes.',
        ),
    ] = False
    robot: Robot = ''
    preset: Annotated[str, typer.Option(help='With --certify: the preset.')] = 'best'
    settings: Annotated[
        list[str] | None,
        typer.Option(
            '--set', metavar='KEY=VALUE', help='With --certify: a value laid over it.'
        ),
    ] = None
    delay: Annotated[
        tuple[float, float],
        typer.Option(metavar='LEAST MOST', help='With --certify: range of T_d [s].'),
    ] = (0.0, 0.008)
    tool: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar='LIGHTEST HEAVIEST',
            help="With --certify: range of the tool's mass [kg]; that of the robot if not given.",
        ),
    ] = None
    mobility: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar='LEAST MOST',
            help='With --certify: range of 1 / the mass of the arm along the normal [1/kg]; that '
            "of the first contact at the arm's home if not given.",
        ),
    ] = None
    slew_time: Annotated[
        float,
        typer.Option(
            help='With --certify: time in which R changes by a factor e at most [s], as '
            'noise_estimator.slew_time has it; 0 lets it jump.',
            min=0.0,
        ),
    ] = 0.1
    fastest: Annotated[
        Fastest,
        typer.Option(
            help='With --certify and --stiffness: the parameter of force that is made as fast as '
            'can be proved, the shortest time_constant or the largest damping_rate, K_2.',
        ),
    ] = 'time_constant'
    attacks: Annotated[
        int,
        typer.Option(
            help='With --certify: runs of adversaries in the region; exit code 1 if V falls by '
            'less than is certified in one.',
            min=0,
        ),
    ] = 0
    jobs: Annotated[
        int,
        typer.Option(
            help='With --certify: jobs at once on this machine; 0 for every core.',
            min=0,
        ),
    ] = 0


@flatten_options
def design(
    context: typer.Context,
    law: Annotated[LawChoice, typer.Argument(metavar='LAW', help='Force law.')],
    model: ModelOptions,
    certified: CertifyOptions,
    out: Annotated[
        Path | None,
        typer.Option(
            help='Parameter file to write, for --preset; with --certify the picture of the '
            'region, a PNG or PDF.'
        ),
    ] = None,
) -> None:
    """
    Find the fastest stable gains of a force law.

    They hold for a range of surfaces, with a gain margin of 2 and a delay margin of one control
    period on the stiffest one, on the linear model of the contact (P04 eq. 32). The file has the
    gains only: the stiffness of the model is printed as a --set option.
    """
    from multicontact_control.commissioning import law_report

    if certified.certify:
        _certify(context, law, model, certified, out)
        return
    result = law_report.design_for_range(
        law,
        stiffness=model.stiffness,
        input_delay=model.input_delay,
        noise_variance=model.noise,
        damping_rate=model.damping_rate,
        period=1.0 / model.rate,
    )
    typer.echo(law_report.describe_design(result))
    if out is not None:
        law_report.write_design(result, out)
        typer.echo(f'written to {out}')


def _certify(
    context: typer.Context,
    law: LawChoice,
    model: ModelOptions,
    asked: CertifyOptions,
    out: Path | None,
) -> None:
    """Print the certified region of a preset, or its fastest certified loop."""
    from multicontact_control.commissioning import certified_region
    from multicontact_control.commissioning.certified_region import require_range
    from multicontact_control.errors import ConfigError
    from multicontact_control.force.certificate import require_solver
    from multicontact_control.runs.overrides import resolve_with
    from multicontact_control.runs.scenario import resolve

    require_solver()
    if out is not None and not (out.suffix in PICTURES and out.parent.is_dir()):
        raise ConfigError('out', 'a .png or .pdf in a folder that is there', str(out))
    if is_given(context, 'stiffness') and (out is not None or asked.attacks):
        raise ConfigError(
            'stiffness',
            'none with --out or --attacks, which are of a region',
            'a range',
        )
    if law != 'aob':
        raise ConfigError('LAW', 'aob, whose gain follows R', law)
    require_range('delay', asked.delay)
    require_range('tool', asked.tool)
    require_range('mobility', asked.mobility, positive=True)
    require_range('stiffness', model.stiffness, positive=True)
    settings = [f'controller.force.law={law}', *(asked.settings or ())]
    arguments = {'scenario': 'step', 'robot': asked.robot, 'preset': asked.preset}

    def resolve_more(more: Sequence[str]) -> Setup:
        return resolve_with(resolve, arguments, [*settings, *more])

    setup = resolve_more([])
    loop = certified_region.make_certified_loop(
        setup, asked.slew_time, asked.tool, asked.mobility
    )
    typer.echo(certified_region.describe_assumptions(loop, setup))
    if is_given(context, 'stiffness'):
        _design_certified(resolve_more, model.stiffness, asked)
    else:
        _print_region(loop, asked, out)


def _design_certified(
    resolve_more: Callable[[Sequence[str]], Setup],
    stiffness: tuple[float, float],
    asked: CertifyOptions,
) -> None:
    """Print the fastest loop that is certified for what is asked for."""
    from multicontact_control.commissioning import certified_design
    from multicontact_control.commissioning.certified_region import make_certified_loop

    own = resolve_more([]).controller
    parameter = asked.fastest
    input_delay = max(0.5 * sum(asked.delay) - own.measuring_delay, 0.0)
    of_model = [
        f'controller.contacts.*.stiffness={math.sqrt(math.prod(stiffness)):.0f}',
        f'controller.force.input_delay={input_delay:.5g}',
    ]

    def add_parameter(value: float) -> list[str]:
        return [*of_model, f'controller.force.{parameter}={value:g}']

    def make_loop(value: float) -> CertifiedLoop:
        setup = resolve_more(add_parameter(value))
        return make_certified_loop(setup, asked.slew_time, asked.tool, asked.mobility)

    found = certified_design.design_certified(
        parameter, make_loop, stiffness, asked.delay, typer.echo, asked.jobs
    )
    own_value = getattr(own.force, parameter)
    typer.echo(
        certified_design.describe_certified(
            parameter, found, own_value, make_loop(own_value)
        )
    )
    certified = add_parameter(found.value)
    typer.echo('certified with ' + ' '.join(f"--set '{each}'" for each in certified))


def _print_region(loop: CertifiedLoop, asked: CertifyOptions, out: Path | None) -> None:
    """Print, draw and attack the region in which a loop is certified."""
    from multicontact_control.commissioning import certified_region
    from multicontact_control.judging.display import make_count_bar
    import numpy as np

    strips = []
    count = len(certified_region.split_delays(asked.delay, loop.model.period))
    with make_count_bar() as bar:
        task = bar.add_task('strips of T_d', total=count)
        for strip in certified_region.map_region(loop, asked.delay, asked.jobs):
            strips.append(strip)
            text = certified_region.describe_strip(strip, loop.model.period)
            bar.console.print(text, highlight=False, soft_wrap=True)
            bar.advance(task)
    share = certified_region.measure_share(strips)
    typer.echo(certified_region.describe_share(share))
    if out is not None:
        title = f'{asked.preset}, model of {loop.stiffness:g} N/m'
        certified_region.draw_region(strips, title).savefig(out, dpi=150)
        typer.echo(f'written to {out}')
    boxes = [box for strip in strips for box in strip.boxes]
    if boxes and asked.attacks:
        rng = np.random.default_rng(0)
        result = certified_region.attack_region(loop, boxes, asked.attacks, rng)
        typer.echo(certified_region.describe_attacks(result))
        if result.violations:
            raise typer.Exit(EXIT_FAILED)
