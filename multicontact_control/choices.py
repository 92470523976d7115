"""
The names of the registry as types, of which pydantic and typer make choices and messages.

They are those that are registered when this is first imported, which configuration and command
line do: a program with a law of its own registers it before it imports either.
"""

from __future__ import annotations

from typing import Literal, TYPE_CHECKING

from multicontact_control.registry import FORCE_LAWS, NOISE_ESTIMATORS

if TYPE_CHECKING:
    LawName = str
    OptionalLawName = str
    EstimatorName = str
else:
    LawName = Literal[tuple(FORCE_LAWS)]
    OptionalLawName = Literal[LawName, '']
    EstimatorName = Literal[tuple(NOISE_ESTIMATORS)]
