"""
The names of the registry as types: for configurations, and for the command line.

A configuration knows what is registered when it is made. The command line shows choices, those
that are registered when this is first imported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TYPE_CHECKING

from multicontact_control.registry import FORCE_LAWS, NOISE_ESTIMATORS


@dataclass(frozen=True)
class NameIn:
    """Marks a text in a configuration as a name of a registry, or one of a few others."""

    registry: Mapping[str, str]
    others: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the present names, in their order."""
        return (*self.registry, *self.others)

    def require_name(self, text: str) -> str:
        """Return a text that is one of the names; ValueError, with all of them, for another."""
        if text not in self.names:
            *names, last = map(repr, self.names)
            raise ValueError(f'expected {", ".join(names)} or {last}')
        return text

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic import AfterValidator  # the help does not wait for it

        validator = AfterValidator(self.require_name)
        return validator.__get_pydantic_core_schema__(source, handler)


LawName = Annotated[str, NameIn(FORCE_LAWS)]
OptionalLawName = Annotated[str, NameIn(FORCE_LAWS, ('',))]
EstimatorName = Annotated[str, NameIn(NOISE_ESTIMATORS)]

if TYPE_CHECKING:
    LawChoice = str
    EstimatorChoice = str
else:
    LawChoice = Literal[tuple(FORCE_LAWS)]
    EstimatorChoice = Literal[tuple(NOISE_ESTIMATORS)]
