"""Designed and tuned force laws, as text and as parameter files."""

from __future__ import annotations

from collections.abc import Mapping
import math
from pathlib import Path
from typing import Any

from multicontact_control.files import write_text
from multicontact_control.force.margins import DesignedLaw
import yaml

NODES = {'controller': '/**/controller_node', 'noise_estimator': '/**/noise_estimator_node'}


def show_design(found: DesignedLaw) -> str:
    """Return gains and margins as a few lines of text."""
    margins = found.margins
    stiffest = 'however stiff it is' if math.isinf(margins.stiffest) else (
        f'up to {margins.stiffest:.2f} times as stiff')
    lines = [
        yaml.safe_dump({'force': rounded(found.values)}, sort_keys=False).rstrip(),
        f'model: {_model(found)}',
        f'on the stiffest surface: phase margin {math.degrees(margins.phase):.0f} deg, delay '
        f'margin {1e3 * margins.delay:.1f} ms, crossover {margins.crossover:.1f} rad/s, stable '
        f'{stiffest}',
        f'63 % of a step after {_milliseconds(found.rise_stiffest)} on the stiffest surface, '
        f'{_milliseconds(found.rise_softest)} on the softest',
        f'noise moves u by {found.input_rms:.3f} m/s^2 rms']
    return '\n'.join(lines)


def rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with four digits, as deep as they are nested."""
    return {name: rounded(value) if isinstance(value, Mapping) else (
        float(f'{value:.4g}') if isinstance(value, float) else value)
        for name, value in values.items()}


def _milliseconds(time: float) -> str:
    return 'never' if math.isinf(time) else f'{1e3 * time:.0f} ms'


def _model(found: DesignedLaw) -> str:
    """Return the stiffness that the gains go with; contacts have names, which no law knows."""
    return (f'{found.stiffness:.0f} N/m '
            f"(--set 'controller.contacts.*.stiffness={found.stiffness:.0f}')")


def write_design(found: DesignedLaw, path: Path) -> None:
    """Write gains as a parameter file, as `--preset` takes it."""
    write_preset({'controller': {'force': rounded(found.values)}}, path,
                 f'designed with a model of {_model(found)}, which is not in here')


def write_preset(sections: Mapping[str, Any], path: Path, what: str) -> None:
    """Write values of controller and noise estimator as a parameter file that `--preset` takes."""
    content = {NODES[section]: {'ros__parameters': values}
               for section, values in sections.items()}
    write_text(path, f'# {what}\n{yaml.safe_dump(content, sort_keys=False)}')
