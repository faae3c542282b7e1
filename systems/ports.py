"""What every LeafSystem here does with its ports: weak callbacks and type checks of Python values."""

import weakref
from collections.abc import Callable
from typing import Any

from pydrake.systems.framework import Context, LeafSystem

from .errors import PortError


def weak_method[R](method: Callable[..., R]) -> Callable[..., R | None]:
    """Returns a callback that calls bound `method` without keeping its object alive; None when it is gone.

    Drake 1.58 on Python 3.12 never frees a system whose bound method was given to `DeclareAbstractOutputPort`
    (vector outputs, inputs, state and events do not have this problem).
    """
    reference = weakref.WeakMethod(method)

    def call(*args: Any) -> R | None:
        target = reference()
        return None if target is None else target(*args)

    return call


def eval_typed[T](system: LeafSystem, context: Context, port_name: str, expected: type[T]) -> T:
    """Evaluates abstract input `port_name` and checks the Python type, which Drake does not do for Python objects.

    Raises:
        PortError: the port is not connected, or carries another type.
    """
    port = system.GetInputPort(port_name)
    where = f"{type(system).__name__}.{port_name}"
    if not port.HasValue(context):
        raise PortError("input port is not connected", where=where, valid=expected.__name__)
    value = port.Eval(context)
    if not isinstance(value, expected):
        raise PortError("wrong type", where=where, value=type(value).__name__, valid=expected.__name__)
    return value
