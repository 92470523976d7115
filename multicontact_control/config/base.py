"""What every configuration is made of: checked types, declared parameters, one base class."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import math
from typing import Annotated, Any, TypeVar

from multicontact_control.errors import ConfigError
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    model_validator,
    ValidationInfo,
)

UNIT_NORM_TOLERANCE = 1e-3
WRENCH_SIZE = 6


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError('expected a finite number')
    return value


def _unit_length(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    norm = math.sqrt(sum(x * x for x in vector))
    if not abs(norm - 1.0) <= UNIT_NORM_TOLERANCE:
        raise ValueError(
            f'expected a vector of unit length (within {UNIT_NORM_TOLERANCE}), length {norm:.6g}')
    x, y, z = (component / norm for component in vector)
    return (x, y, z)


ModelT = TypeVar('ModelT', bound='Config')

Real = Annotated[float, AfterValidator(_finite)]
Vector = tuple[Real, ...]
Vector3 = tuple[Real, Real, Real]
UnitVector3 = Annotated[Vector3, AfterValidator(_unit_length)]


def parameter(
    default: Any, description: str, *, unit: str = '', live: bool = False, **bounds: Any,
) -> Any:
    """
    Declare one tunable value.

    Parameters
    ----------
    default
        Default value; ``...`` makes the value required.
    description
        One sentence; the unit is appended to it in the ROS parameter description.
    unit
        SI unit, empty for names and flags.
    live
        Whether the value may be changed while a node runs.
    bounds
        Pydantic bounds: ``gt``, ``ge``, ``lt``, ``le``, ``min_length``.

    Returns
    -------
    Any
        A pydantic field.

    """
    return Field(
        default, description=description, json_schema_extra={'unit': unit, 'live': live}, **bounds)


class Config(BaseModel):
    """Base of every configuration: frozen, and strict about unknown keys."""

    model_config = ConfigDict(extra='forbid', frozen=True, validate_default=True)


def cross_check(check: Callable[[ModelT], Iterable[ConfigError]]) -> Any:
    """
    Make a method of a configuration one of its checks.

    Parameters
    ----------
    check
        Yields a `ConfigError` for whatever does not fit together. `validate` asks every model for
        all of them; otherwise, by its constructor, a model raises its own.

    """
    def run(self: ModelT, info: ValidationInfo) -> ModelT:
        errors = list(check(self))
        if errors and isinstance(info.context, list):
            info.context.extend(errors)
        elif errors:
            raise ConfigError.of(errors)
        return self

    return model_validator(mode='after')(run)
