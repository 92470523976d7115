"""
ROS parameters from configuration models, and back.

Nested fields of a model get dotted names, a mapping such as ``contacts`` one set per name in
``contact_names``. ROS holds values of any type; the models alone say what is acceptable, so that
all errors are found at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
import traceback
from types import NoneType
import typing
from typing import Any

from multicontact_control.config.base import (
    Config,
    find_config_model,
    merge,
    sets_parameter,
    validate,
)
from multicontact_control.errors import ConfigError, MulticontactError, run_all_checks
from multicontact_control.nodes.private import parameter_overrides
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.node import Node
from rclpy.parameter import Parameter

SET_BY_ROS = ('use_sim_time', 'start_type_description_service', 'qos_overrides')
LOCKED = 'can be changed only before the node is configured'


def _list_fields(
    model: type[Config],
    overrides: Mapping[str, Any],
    prefix: str = '',
) -> Iterator[tuple[str, FieldInfo]]:
    """Yield the dotted name and the field of each value of a model, with those of its parts."""
    for key, field in model.model_fields.items():
        name = prefix + key
        inner = find_config_model(field.annotation)
        if inner is None:
            yield name, field
        elif typing.get_origin(field.annotation) is dict:
            for entry in _list_entries(name, overrides):
                yield from _list_fields(inner, overrides, f'{name}.{entry}.')
        else:
            yield from _list_fields(inner, overrides, f'{name}.')


def _list_entries(name: str, overrides: Mapping[str, Any]) -> Sequence[str]:
    """Return the entries of a mapping that overrides set values of, by default the contacts."""
    start = f'{name}.'
    given = {}  # in their order, each once
    for override in overrides:
        if override.startswith(start):
            entry, _, _ = override.removeprefix(start).partition('.')
            given[entry] = True
    return [*given] or overrides.get('contact_names') or ()


def _describe_parameter(name: str, field: FieldInfo) -> ParameterDescriptor:
    """Return the descriptor of a parameter: what it is, its unit, and whether it may change."""
    extra: Any = field.json_schema_extra or {}
    description = field.description or ''
    if extra.get('unit'):
        description += f' [{extra["unit"]}]'
    # Not read-only: that changes with the life cycle, a descriptor does not.
    return ParameterDescriptor(
        name=name,
        dynamic_typing=True,
        description=description,
        additional_constraints='' if extra.get('live') else LOCKED,
    )


def _return_configurations(configurations: Sequence[Any]) -> Any:
    """Return the configurations as their own design."""
    return configurations


def _ignore_refusal(_name: str, _error: Exception) -> None:
    """Take no note of a refused change."""


class ParameterSet:
    """
    Declares the parameters of models, and lets those that are live change.

    While `apply_design` is None all parameters may change, and are validated when a configuration
    is built. Then only live ones may: `compute_design` makes a design of the configurations with a
    change, and `apply_design` puts it into force; either raises to refuse the change.

    Attributes
    ----------
    compute_design, apply_design, report_refusal
        Functions of the node: see above; `report_refusal` is called with the name and the error of
        a change that is refused.
    version
        Number of changes so far; a design that was begun with another one is out of date.

    """

    def __init__(self, node: Node, *models: type[Config]) -> None:
        self._node = node
        self._models = models
        self.compute_design: Callable[[Sequence[Any]], Any] = _return_configurations
        self.apply_design: Callable[[Any], None] | None = None
        self.report_refusal: Callable[[str, Exception], None] = _ignore_refusal
        self.version = 0
        # Returns or raises what the change that is under way leads to.
        self._get_design: Callable[[], Any] | None = None
        self._live: dict[str, bool] = {}  # by the name of each declared parameter
        given = {}
        for name, parameter in parameter_overrides(node).items():
            if name.split('.')[0] not in SET_BY_ROS:
                given[name] = parameter.value
        for model in models:
            for name, field in _list_fields(model, given):
                self._declare_parameter(name, field, given)
        self._unknown = {
            name: value for name, value in given.items() if name not in self._live
        }
        node.add_on_set_parameters_callback(self._on_set)

    def _declare_parameter(
        self, name: str, field: FieldInfo, given: Mapping[str, Any]
    ) -> None:
        """Declare a parameter with the value that is given, or its default; None for neither."""
        value = None
        if name in given:
            value = [] if given[name] is None else given[name]
        elif not field.is_required():
            value = field.get_default(call_default_factory=True)
        descriptor = _describe_parameter(name, field)
        self._live[name] = descriptor.additional_constraints != LOCKED
        self._node.declare_parameter(
            name, _to_plain_value(value), descriptor, ignore_override=True
        )

    def build_configurations(
        self, changes: Mapping[str, Any] | None = None
    ) -> list[Any]:
        """
        Return a validated configuration per model.

        Parameters
        ----------
        changes
            Values by dotted name that take the place of the present ones.

        Raises
        ------
        ConfigError
            With all that is wrong at once, parameters that no model knows among it.

        """
        present = {name: self.present_value(name) for name in self._live}
        if changes is not None:
            present |= changes
        values: dict[str, Any] = {}
        for name, value in [*present.items(), *self._unknown.items()]:
            if value is not None:
                for part in reversed(name.split('.')):
                    value = {part: value}
                values = merge(values, value)
        known = sorted(key for model in self._models for key in model.model_fields)

        def refuse_unknown(key: str) -> None:
            raise ConfigError(
                key, f'a known parameter ({", ".join(known)})', f"unknown '{key}'"
            )

        checks: list[Callable[[], Any]] = []
        for key in values:
            if key not in known:
                checks.append(partial(refuse_unknown, key))
        for model in self._models:
            given = {key: values[key] for key in model.model_fields if key in values}
            checks.append(partial(validate, model, given))
        return run_all_checks(*checks)

    def present_value(self, name: str) -> Any:
        """Return the present value of a parameter, arrays as lists; None if it has none."""
        return _to_plain_value(self._node.get_parameter_or(name).value)

    def design_change(self, parameters: Sequence[Parameter]) -> Any:
        """
        Return the design that a change of parameters leads to; the background thread calls this.

        Raises
        ------
        MulticontactError
            If a parameter is not live, or the configuration with the change cannot be used.

        """
        changes = self._select_known(parameters)
        for name, value in changes.items():
            present = self.present_value(name)
            if value is None or (value != present and not self._live[name]):
                raise ConfigError(name, hint=f'{LOCKED}; it stays {present}')
        return self.compute_design(self.build_configurations(changes))

    def apply(
        self, parameters: Sequence[Parameter], get_design: Callable[[], Any]
    ) -> SetParametersResult:
        """
        Change all parameters at once, or none, by the design that has been computed for them.

        `get_design` returns what `design_change` has returned, or raises what it has raised.

        """
        self._get_design = get_design
        try:
            return self._node.set_parameters_atomically(parameters)
        except ParameterNotDeclaredException as error:
            return SetParametersResult(successful=False, reason=str(error))
        finally:
            self._get_design = None

    def _select_known(self, parameters: Sequence[Parameter]) -> dict[str, Any]:
        """Return the new values of those parameters that are of a model."""
        return {
            parameter.name: _to_plain_value(parameter.value)
            for parameter in parameters
            if parameter.name in self._live
        }

    def _on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        changes = self._select_known(parameters)
        if self.apply_design is None or not changes:
            return SetParametersResult(successful=True)
        get_design = self._get_design
        if get_design is None:
            get_design = partial(self.design_change, parameters)
        try:
            self.apply_design(get_design())
        except Exception as error:
            if not isinstance(error, MulticontactError):
                # A mistake here ends no node: the arm would have to pay for it.
                self._node.get_logger().error(traceback.format_exc())
            first_name, *_ = changes
            self.report_refusal(first_name, error)
            reason = str(error) or repr(error)
            return SetParametersResult(successful=False, reason=reason)
        self.version += 1
        return SetParametersResult(successful=True)


def _to_plain_value(value: Any) -> Any:
    """Return an array as a list."""
    if isinstance(value, (bool, int, float, str, NoneType)):
        return value
    return list(value)


def find_parameter_folder(name: str, node_name: str, arguments: Sequence[str]) -> Path:
    """
    Return where a relative path starts that is the value of a parameter of a node.

    That is the folder of the last parameter file that sets the parameter; the current folder if
    the command line itself sets it, or nothing does.

    Parameters
    ----------
    name, node_name
        Dotted name of the parameter, and name of its node.
    arguments
        Arguments of the command line, with `--params-file FILE` and `-p NAME:=VALUE`.

    """
    folder = Path()
    for option, value in zip(arguments, arguments[1:]):
        if option in ('-p', '--param'):
            given, _, _ = value.partition(':=')
            if given.rpartition(':')[2] == name:
                return Path()
        if option == '--params-file' and sets_parameter(Path(value), node_name, name):
            folder = Path(value).resolve().parent
    return folder


def load_parameters(node: Node, *models: type[Config]) -> list[Any]:
    """
    Declare the parameters of models, and return a validated configuration per model.

    From then on they stay as they are. ConfigError with all that is wrong with them.
    """
    parameters = ParameterSet(node, *models)
    configurations = parameters.build_configurations()
    parameters.apply_design = _return_configurations
    return configurations
