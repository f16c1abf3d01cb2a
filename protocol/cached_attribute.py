"""An attribute that is computed at its first use. Unlike functools.cached_property it takes no lock, which costs less."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

T = TypeVar("T")


class cached_attribute(Generic[T]):
    """Decorator of a method without arguments; the result replaces the method in the instance."""

    def __init__(self, method: Callable[[Any], T]) -> None:
        self._method = method
        self.__doc__ = method.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type) -> "cached_attribute[T]": ...

    @overload
    def __get__(self, instance: object, owner: type) -> T: ...

    def __get__(self, instance: object | None, owner: type) -> "T | cached_attribute[T]":
        if instance is None:
            return self
        value = instance.__dict__[self._name] = self._method(instance)
        return value
