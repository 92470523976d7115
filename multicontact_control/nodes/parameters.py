"""
ROS parameters from configuration models, and back.

A model of `multicontact_control.config` says name, type, default, unit, description and range of
every value. Here each becomes a ROS parameter: nested fields get dotted names, a mapping such as
``contacts`` one set of parameters per name in ``contact_names``. A managed node keeps them in a
`ParameterSet`, loaded when it configures and changed while it runs; the others load them once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
import copy
from dataclasses import dataclass
from functools import partial
import sys
import traceback
from types import NoneType
import typing
from typing import Any, Literal

from multicontact_control.config import Config, validate
from multicontact_control.errors import check_all, ConfigError, MulticontactError
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

Type = Parameter.Type
Check = Callable[[Sequence[Any]], None]

NAMES_OF_MAPPINGS = 'contact_names'
SET_BY_ROS = ('use_sim_time', 'start_type_description_service', 'qos_overrides')
INTEGER_LIMIT = 2 ** 63 - 1
LOCKED = 'can be changed only while the node is unconfigured'

_SCALAR_TYPES = {bool: Type.BOOL, int: Type.INTEGER, float: Type.DOUBLE, str: Type.STRING}
_ARRAY_TYPES = {
    bool: Type.BOOL_ARRAY, int: Type.INTEGER_ARRAY, float: Type.DOUBLE_ARRAY,
    str: Type.STRING_ARRAY}


@dataclass(frozen=True)
class ParameterSpec:
    """A ROS parameter: dotted name, type, default (None without), and what ROS tools show."""

    name: str
    type: Parameter.Type  # noqa: A003
    default: Any
    descriptor: ParameterDescriptor


def parameter_specs(
    model: type[Config], overrides: Mapping[str, Any], prefix: str = '',
) -> Iterator[ParameterSpec]:
    """
    Yield the parameters of a model.

    Parameters
    ----------
    model
        Configuration class.
    overrides
        Values by dotted name; they say which names a mapping has.
    prefix
        Prefix of the dotted names, with its dot.

    """
    for key, field in model.model_fields.items():
        name = prefix + key
        annotation = _without_none(field.annotation)
        if isinstance(annotation, type) and issubclass(annotation, Config):
            yield from parameter_specs(annotation, overrides, f'{name}.')
        elif typing.get_origin(annotation) is dict:
            yield from _mapping_specs(annotation, field, overrides, name)
        else:
            yield _leaf_spec(name, annotation, field)


def _mapping_specs(
    annotation: Any, field: FieldInfo, overrides: Mapping[str, Any], name: str,
) -> Iterator[ParameterSpec]:
    """Yield the parameters of a mapping: those of each name, or one number per name."""
    value_type = _without_annotated(typing.get_args(annotation)[1])
    for entry in _mapping_names(name, overrides):
        if isinstance(value_type, type) and issubclass(value_type, Config):
            yield from parameter_specs(value_type, overrides, f'{name}.{entry}.')
        else:
            yield _leaf_spec(f'{name}.{entry}', value_type, field)


def _mapping_names(name: str, overrides: Mapping[str, Any]) -> list[str]:
    """Return the names that a mapping has values for, or else those in the list of names."""
    listed = [x for x in overrides.get(NAMES_OF_MAPPINGS) or () if isinstance(x, str)]
    start = f'{name}.'
    found = {key[len(start):].split('.')[0]: None for key in overrides if key.startswith(start)}
    return sorted(found, key=lambda x: listed.index(x) if x in listed else len(listed)) or listed


def _leaf_spec(name: str, annotation: Any, field: FieldInfo) -> ParameterSpec:
    ros_type, choices = _ros_type(name, annotation)
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    unit = extra.get('unit')
    descriptor = ParameterDescriptor(
        name=name, type=ros_type.value, read_only=not extra.get('live', False),
        description=(field.description or '') + (f' [{unit}]' if unit else ''),
        additional_constraints=f'one of {", ".join(choices)}' if choices else '')
    _add_range(descriptor, ros_type, field)
    default = None if field.is_required() else field.get_default(call_default_factory=True)
    if isinstance(default, Mapping):
        default = default.get(name.rsplit('.', 1)[-1])
    if isinstance(default, (tuple, list)):
        default = list(default)
    return ParameterSpec(name, ros_type, default, descriptor)


def _ros_type(name: str, annotation: Any) -> tuple[Parameter.Type, tuple[str, ...]]:
    """Return the ROS type of an annotation, and the choices if there are only a few."""
    annotation = _without_annotated(annotation)
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Literal:
        return Type.STRING, tuple(str(choice) for choice in arguments)
    if origin in (tuple, list) and arguments:
        element = _without_annotated(arguments[0])
        if typing.get_origin(element) is Literal:
            return Type.STRING_ARRAY, tuple(str(c) for c in typing.get_args(element))
        if element in _ARRAY_TYPES:
            return _ARRAY_TYPES[element], ()
    elif annotation in _SCALAR_TYPES:
        return _SCALAR_TYPES[annotation], ()
    raise ConfigError(name, 'a type that a ROS parameter can hold', annotation)


def _without_annotated(annotation: Any) -> Any:
    while typing.get_origin(annotation) is typing.Annotated:
        annotation = typing.get_args(annotation)[0]
    return annotation


def _without_none(annotation: Any) -> Any:
    arguments = typing.get_args(annotation)
    if NoneType in arguments:
        return next(argument for argument in arguments if argument is not NoneType)
    return _without_annotated(annotation)


def _add_range(
    descriptor: ParameterDescriptor, ros_type: Parameter.Type, field: FieldInfo,
) -> None:
    """Add the range of a number; a ROS range is closed, the model is stricter where it is not."""
    bounds: dict[str, Any] = {}
    for constraint in field.metadata:
        for attribute, end in (('ge', 'from'), ('gt', 'from'), ('le', 'to'), ('lt', 'to')):
            value = getattr(constraint, attribute, None)
            if value is not None:
                bounds[end] = value
    if not bounds:
        return
    if ros_type is Type.DOUBLE:
        limit = sys.float_info.max
        descriptor.floating_point_range = [FloatingPointRange(
            from_value=float(bounds.get('from', -limit)),
            to_value=float(bounds.get('to', limit)))]
    elif ros_type is Type.INTEGER:
        descriptor.integer_range = [IntegerRange(
            from_value=int(bounds.get('from', -INTEGER_LIMIT)),
            to_value=int(bounds.get('to', INTEGER_LIMIT)), step=1)]


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by dotted name as nested mappings."""
    result: dict[str, Any] = {}
    for name, value in values.items():
        *path, key = name.split('.')
        level = result
        for depth, part in enumerate(path):
            level = level.setdefault(part, {})
            if not isinstance(level, dict):
                raise ConfigError('.'.join(path[:depth + 1]), 'a mapping', level)
        level[key] = value
    return result


def _parameter_overrides(node: Node) -> dict[str, Any]:
    """Return what the command line and its parameter files set; None for an empty list."""
    # The public ways refuse an integer for a number and an empty list, and hide unknown names.
    overrides: dict[str, Parameter] = getattr(node, '_parameter_overrides')  # noqa: B009
    return {
        name: parameter.value for name, parameter in overrides.items()
        if name.split('.')[0] not in SET_BY_ROS}


def _refuse_unknown_keys(values: Mapping[str, Any], models: Sequence[type[Config]]) -> None:
    known = {key for model in models for key in model.model_fields}
    errors = [
        ConfigError(key, f'a known parameter ({", ".join(sorted(known))})', f"unknown '{key}'")
        for key in values if key not in known]
    if errors:
        raise ConfigError.of(errors)


def _parameter_value(spec: ParameterSpec, overrides: Mapping[str, Any]) -> Any:
    """Return the given or default value of a parameter, None if there is neither."""
    value = overrides.get(spec.name, spec.default)
    if value is None:
        # ROS has no type for an empty list in a parameter file.
        return [] if spec.type in _ARRAY_TYPES.values() else value
    if spec.type is Type.DOUBLE and type(value) is int:
        return float(value)
    if spec.type is Type.DOUBLE_ARRAY:
        return [float(x) if type(x) is int else x for x in value]
    return list(value) if spec.type in _ARRAY_TYPES.values() else value


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
    constraint
        What is said of the parameters that are not live.

    """

    def __init__(
        self, node: Node, *models: type[Config], constraint: str = LOCKED,
    ) -> None:
        self._node, self._models, self._constraint = node, models, constraint
        self._given = _parameter_overrides(node)
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

    def freeze(self) -> None:
        """Make all but the live parameters read-only for good."""
        for name in set(self._specs) - self._live:
            # Not in place: the node has the descriptor itself, and would refuse to change it.
            descriptor = copy.deepcopy(self._specs[name].descriptor)
            descriptor.read_only = True
            self._node.set_descriptor(name, descriptor)

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
            Naming every parameter that is unknown, missing or not acceptable.

        """
        values = {**self._undeclared, **self._values(self._specs), **(changes or {})}
        by_key = nested(values)
        _, *configurations = check_all(
            partial(_refuse_unknown_keys, by_key, self._models),
            *(partial(validate, model, {
                key: value for key, value in by_key.items() if key in model.model_fields})
              for model in self._models))
        return configurations

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
                filter(None, (descriptor.additional_constraints, self._constraint)))
        self._node.declare_parameter(spec.name, spec.type, descriptor, ignore_override=True)
        value = _parameter_value(spec, self._given)
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
        except Exception as error:
            if not isinstance(error, MulticontactError):  # a mistake here: not for the arm to pay
                self._node.get_logger().error(traceback.format_exc())
            self.refused(next(iter(changes)), error)
            return SetParametersResult(successful=False, reason=str(error) or repr(error))
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


def load_parameters(node: Node, *models: type[Config]) -> list[Any]:
    """
    Declare the parameters of some models on a node and return their configurations, for good.

    Raises
    ------
    ConfigError
        Naming every parameter that is unknown, missing or not acceptable.

    """
    parameters = ParameterSet(node, *models, constraint='')
    configurations = parameters.configurations()
    parameters.freeze()
    return configurations
