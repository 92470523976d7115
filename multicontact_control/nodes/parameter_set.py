"""The parameters of a managed node: loaded when it configures, changed while it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from multicontact_control.config import Config, validate
from multicontact_control.errors import ConfigError, MulticontactError
from multicontact_control.nodes.parameters import (
    nested,
    parameter_overrides,
    parameter_specs,
    parameter_value,
    ParameterSpec,
    refuse_unknown_keys,
)
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

LOCKED = 'can be changed only while the node is unconfigured'

Check = Callable[[Sequence[Any]], None]


class ParameterSet:
    """
    Declares the parameters of some models, and turns their values into configurations.

    A value that cannot be declared as what it should be is kept, so that `configurations` can
    refuse it by name; setting a better one repairs that. Once `lock` has been called, a change
    must be of a live parameter, lead to valid configurations and pass the node's own check;
    only then the whole new configurations are handed to the node.

    Parameters
    ----------
    node
        The node.
    models
        Configuration classes without common field names.

    """

    def __init__(self, node: Node, *models: type[Config]) -> None:
        self._node = node
        self._models = models
        self._given = parameter_overrides(node)
        self._specs = {
            spec.name: spec for model in models for spec in parameter_specs(model, self._given)}
        self._live = {x.name for x in self._specs.values() if not x.descriptor.read_only}
        self._undeclared = {
            name: value for name, value in self._given.items()
            if name not in self._specs or not self._declare(self._specs[name])}
        for name, spec in self._specs.items():
            if name not in self._given:
                self._declare(spec)
        self._check: Check | None = None
        self._apply: Check | None = None
        self._pending: list[Any] | None = None
        self.refused: Callable[[str, Exception], None] = lambda name, error: None
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._on_applied)

    def lock(self, check: Check, apply: Check) -> None:
        """
        Let only live parameters change from now on.

        Parameters
        ----------
        check
            Called with new configurations; raises `MulticontactError` if they cannot be used.
        apply
            Called with them once they are in force.

        """
        self._check, self._apply = check, apply

    def unlock(self) -> None:
        """Let every parameter change, to be validated when it is used."""
        self._check = self._apply = None

    def configurations(self, changes: Mapping[str, Any] | None = None) -> list[Any]:
        """
        Return one frozen configuration per model, of the present values.

        Parameters
        ----------
        changes
            Values by dotted name to use instead.

        Raises
        ------
        ConfigError
            Naming the first parameter that is unknown, missing or not acceptable.

        """
        values = {**self._undeclared, **self._values(self._specs), **(changes or {})}
        refuse_unknown_keys(nested(values), self._models)
        return [
            validate(model, nested({
                name: value for name, value in values.items()
                if name.split('.')[0] in model.model_fields})) for model in self._models]

    def value(self, name: str) -> Any:
        """Return the present value of one parameter, None if it has none."""
        return self._values([name]).get(name)

    def assign(self, name: str, value: Any) -> None:
        """
        Change a parameter as its user could.

        Raises
        ------
        ConfigError
            If that is refused.

        """
        parameter = Parameter(name, self._specs[name].type, value)
        result = self._node.set_parameters([parameter])[0]
        if not result.successful:
            raise ConfigError(name, 'an acceptable value', f'{value} ({result.reason})')

    def _values(self, names: Iterable[str]) -> dict[str, Any]:
        values = {}
        for name in names:
            value = self._node.get_parameter_or(name).value
            if value is not None:
                values[name] = _plain(value)
        return values

    def _declare(self, spec: ParameterSpec) -> bool:
        """Declare a parameter; return whether its given value could be set."""
        descriptor = spec.descriptor
        descriptor.read_only = False  # `lock` decides that, and a descriptor cannot be unlocked
        if spec.name not in self._live:
            descriptor.additional_constraints = '; '.join(
                filter(None, (descriptor.additional_constraints, LOCKED)))
        self._node.declare_parameter(spec.name, spec.type, descriptor, ignore_override=True)
        value = parameter_value(spec, self._given)
        if value is None:
            return True
        try:
            parameter = Parameter(spec.name, spec.type, value)
        except (ValueError, TypeError, AttributeError):
            return False  # not of that type
        return bool(self._node.set_parameters([parameter])[0].successful)

    def _on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        self._pending = None
        changes = {x.name: _plain(x.value) for x in parameters if x.name in self._specs}
        if self._check is None or not changes:
            return SetParametersResult(successful=True)
        try:
            self._refuse_locked(changes)
            configurations = self.configurations(changes)
            self._check(configurations)
        except MulticontactError as error:
            self.refused(next(iter(changes)), error)
            return SetParametersResult(successful=False, reason=str(error))
        self._pending = configurations
        return SetParametersResult(successful=True)

    def _refuse_locked(self, changes: Mapping[str, Any]) -> None:
        for name, value in changes.items():
            if name not in self._live and value != self.value(name):
                raise ConfigError(name, f'{self.value(name)}: it {LOCKED}', value)

    def _on_applied(self, parameters: Sequence[Parameter]) -> None:
        for parameter in parameters:
            self._undeclared.pop(parameter.name, None)
        if self._pending is not None and self._apply is not None:
            configurations, self._pending = self._pending, None
            self._apply(configurations)


def _plain(value: Any) -> Any:
    """Return an array as a list."""
    return value if isinstance(value, (bool, int, float, str)) else list(value)
