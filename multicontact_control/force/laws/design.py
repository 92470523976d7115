"""What a file of this folder declares: how a force law is designed, and from which gains."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from multicontact_control.config import ForceConfig
from multicontact_control.errors import ConfigError
from multicontact_control.force.laws.linear import LinearLaw
from multicontact_control.force.observer import ObserverDesign
from multicontact_control.force.plant import DelayedPlant, make_delayed_plant
from multicontact_control.registry import FORCE_LAWS, import_registered


@dataclass(frozen=True, slots=True)
class LoopModel:
    """The model of a contact that a force law is designed for (P04 eq. 32)."""

    stiffness: float  # k [N/m]
    damping_rate: float  # K_2 [1/s]
    input_delay: float  # T_d [s]
    period: float  # h [s]

    @property
    def plant(self) -> DelayedPlant:
        """Return k e^(-s T_d) / (s (s + K_2)), discretised with h (P04 eq. 33)."""
        return make_delayed_plant(
            self.stiffness, self.damping_rate, self.input_delay, self.period
        )


class LawDesign(NamedTuple):
    """
    A force law as its file declares it, under the name `LAW`.

    `design` has only the fields `reads` of the configuration: laws whose values there are equal
    share one design. `multicontact design` makes a law s times as fast as usual by multiplying
    each gain in `speed_exponents` by s to the power that stands there.
    """

    # Makes the law from the model of the contact and the gains; ValueError if it cannot.
    design: Callable[[LoopModel, ForceConfig], ObserverDesign | LinearLaw]

    reads: tuple[str, ...]  # fields of `ForceConfig`
    speed_exponents: Mapping[str, Any]  # by gain, nested as in `ForceConfig`
    noise_gain: tuple[str, ...] = ()  # section and name of the gain that is R [N^2]


def find_law(name: str) -> LawDesign:
    """
    Return a registered force law by name; its file is imported when it is first needed.

    Raises
    ------
    ConfigError
        If a law of another package cannot be imported, is no `LawDesign`, or reads what is no
        field of `ForceConfig`.

    """
    title = f'force law {name}'
    law = import_registered(title, FORCE_LAWS[name])
    if not isinstance(law, LawDesign):
        raise ConfigError(title, f'a LawDesign at {FORCE_LAWS[name]}', repr(law))
    unknown = set(law.reads) - ForceConfig.model_fields.keys()
    if unknown:
        fields = ', '.join(ForceConfig.model_fields)
        raise ConfigError(f'{title}: reads', f'some of {fields}', min(unknown))
    return law
