"""State of objects as plain arrays and JSON, and back into objects made anew: it goes on bit by bit, and runs nothing.

An :class:`Encoder` follows the attributes of our own classes. What a fresh object holds as well (frozen constants,
models of files, functions, classes) is not written; what such an object has only later has to be named as a record.
"""

from __future__ import annotations

import dataclasses
import enum
import types
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
import pydantic
from numpy.typing import NDArray
from scipy import sparse

_OWN = "isf_"
"""Objects of classes of our own packages are followed."""


class StateMismatchError(ValueError):
    """A value does not fit the object it is meant for."""


class Encoder:
    """Collects arrays while it turns values into JSON-able ones."""

    def __init__(self, records: tuple[type, ...] = (), enums: tuple[type[enum.Enum], ...] = ()) -> None:
        self.arrays: list[NDArray[Any]] = []
        self._seen: dict[int, int] = {}
        self._records = {kind.__name__: kind for kind in records}
        self._enums = {kind.__name__: kind for kind in enums}

    def encode(self, value: Any) -> Any:
        """JSON-able form of ``value``; TypeError for what is neither state nor known to be constant."""
        if value is None or isinstance(value, bool | str):
            return {"v": value}
        if isinstance(value, enum.Enum):
            if type(value).__name__ not in self._enums:
                raise TypeError(f"cannot save {type(value)}")
            return {"e": [type(value).__name__, value.value]}
        if isinstance(value, int):
            return {"v": int(value)}
        if isinstance(value, float):
            return {"f": float(value).hex()}
        if isinstance(value, np.generic):
            return self.encode(value.item())
        if isinstance(value, np.ndarray):
            return {"a": self._keep(value)}
        if isinstance(value, np.random.Generator):
            return {"g": value.bit_generator.state}
        return self._encode_compound(value)

    def _encode_compound(self, value: Any) -> Any:
        if type(value).__name__ in self._records:
            names = getattr(value, "_fields", None) or [item.name for item in dataclasses.fields(value)]
            return {"r": [type(value).__name__, {name: self.encode(getattr(value, name)) for name in names}]}
        if isinstance(value, tuple | list):
            kind = "n" if hasattr(value, "_fields") else "t" if isinstance(value, tuple) else "l"
            return {kind: [self.encode(item) for item in value]}
        if isinstance(value, deque):
            return {"q": [self.encode(item) for item in value]}
        if isinstance(value, dict):
            return {"d": [[self.encode(key), self.encode(item)] for key, item in value.items()]}
        if sparse.issparse(value):
            return {"a": self._keep(value.data)} if hasattr(value, "indptr") else {"k": 0}
        if _is_constant(value):
            return {"k": 0}
        if type(value).__module__.startswith(_OWN):
            return {"o": {name: self.encode(item) for name, item in _attributes(value).items()}}
        raise TypeError(f"cannot save a {type(value).__module__}.{type(value).__name__}")

    def _keep(self, array: NDArray[Any]) -> int:
        if array.dtype.hasobject:
            raise TypeError("cannot save an array of objects")
        if id(array) not in self._seen:
            self._seen[id(array)] = len(self.arrays)
            self.arrays.append(array)
        return self._seen[id(array)]

    def decode(self, code: Any, arrays: list[NDArray[Any]], into: Any) -> Any:
        """Value of ``code``; ``into`` is the fresh value in its place, written in place where that can be done.

        Raises
        ------
        StateMismatchError : the code is of another build
        """
        ((kind, body),) = code.items()
        if kind == "v":
            return body
        if kind == "f":
            return float.fromhex(body)
        if kind == "e":
            return self._enums[body[0]](body[1])
        if kind == "a":
            return _array(arrays[body], into)
        if kind == "g":
            into.bit_generator.state = body
            return into
        if kind == "k":
            return into
        if kind == "r":
            record = self._records[body[0]]
            return record(**{name: self.decode(item, arrays, None) for name, item in body[1].items()})
        if kind == "o":
            return self._decode_object(body, arrays, into)
        return self._decode_container(kind, body, arrays, into)

    def _decode_object(self, body: dict[str, Any], arrays: list[NDArray[Any]], into: Any) -> Any:
        own = type(into).__module__.startswith(_OWN)
        fields = _attributes(into) if own else {}
        if not own or set(body) != set(fields):
            raise StateMismatchError(
                f"{type(into).__name__} has other fields than the file ({differing(body, fields)})"
            )
        for name, item in body.items():
            object.__setattr__(into, name, self.decode(item, arrays, fields[name]))
        return into

    def _decode_container(self, kind: str, body: list[Any], arrays: list[NDArray[Any]], into: Any) -> Any:
        if kind == "d":
            fresh = into if isinstance(into, dict) else {}
            pairs = [(self.decode(key, arrays, None), item) for key, item in body]
            return {key: self.decode(item, arrays, fresh.get(key)) for key, item in pairs}
        if kind == "q":
            return deque((self.decode(item, arrays, None) for item in body), maxlen=into.maxlen)
        old = list(into) if isinstance(into, tuple | list) else []
        items = [self.decode(item, arrays, old[k] if k < len(old) else None) for k, item in enumerate(body)]
        if kind == "l":
            return items
        if kind == "t":
            return tuple(items)
        if not hasattr(into, "_fields") or len(old) != len(items):
            raise StateMismatchError(f"{type(into).__name__} has other fields than the file")
        return into if all(new is was for new, was in zip(items, old, strict=True)) else type(into)(*items)


def differing(saved: Iterable[str], present: Iterable[str]) -> str:
    """Names that are only in the one or the other, for a message."""
    old, new = set(saved), set(present)
    parts = (("only in the file", old - new), ("missing in it", new - old))
    return "; ".join(f"{words}: {', '.join(sorted(names))}" for words, names in parts if names)


def _attributes(value: Any) -> dict[str, Any]:
    """Attributes of an object by their names, in a dictionary of its own or in slots."""
    if hasattr(value, "__dict__"):
        return vars(value)
    return {name: getattr(value, name) for name in getattr(type(value), "__slots__", ())}


def _is_constant(value: Any) -> bool:
    """What a fresh tree holds as well: models of files, frozen constants, functions, classes, caches that say so."""
    frozen = getattr(getattr(type(value), "__dataclass_params__", None), "frozen", False)
    return bool(
        frozen
        or getattr(type(value), "constant_of_state", False)
        or isinstance(value, pydantic.BaseModel | type | types.FunctionType | types.MethodType)
        or type(value).__name__ == "CPUDispatcher"
    )


def _array(array: NDArray[Any], into: Any) -> Any:
    if sparse.issparse(into):
        if into.data.shape != array.shape:
            raise StateMismatchError("a matrix of another size")
        into.data[...] = array
        return into
    if (
        isinstance(into, np.ndarray)
        and into.shape == array.shape
        and into.dtype == array.dtype
        and into.flags.writeable
    ):
        into[...] = array
        return into
    return array.copy()
