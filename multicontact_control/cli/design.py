"""`multicontact design`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from multicontact_control.choices import LawChoice
from multicontact_control.cli.options import flatten_options
import typer


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


@flatten_options
def design(
    law: Annotated[LawChoice, typer.Argument(metavar='LAW', help='Force law.')],
    model: ModelOptions,
    out: Annotated[
        Path | None, typer.Option(help='Parameter file to write, for --preset.')
    ] = None,
) -> None:
    """
    Find the fastest stable gains of a force law.

    They hold for a range of surfaces, with a gain margin of 2 and a delay margin of one control
    period on the stiffest one, on the linear model of the contact (P04 eq. 32). The file has the
    gains only: the stiffness of the model is printed as a --set option.
    """
    from multicontact_control.commissioning import law_report

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
