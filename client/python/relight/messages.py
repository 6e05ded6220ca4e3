# SPDX-License-Identifier: MIT
"""Classes of the messages of relight.proto, made from its compiled description."""
from __future__ import annotations

import os
from typing import Any, Dict

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from .errors import RelightError

_POOL = descriptor_pool.DescriptorPool()
_made: Dict[str, Any] = {}


def _load() -> None:
    path = os.path.join(os.path.dirname(os.path.abspath(__file__)), "relight.desc")
    files = descriptor_pb2.FileDescriptorSet()
    with open(path, "rb") as f:
        files.ParseFromString(f.read())
    for file in files.file:
        _POOL.Add(file)


_load()


def message(name: str, /, **fields: Any) -> Any:
    """A message of this name ("ColorsRequest") with these fields."""
    if name not in _made:
        descriptor = _POOL.FindMessageTypeByName("relight." + name)
        if hasattr(message_factory, "GetMessageClass"):  # protobuf 4.22 and later
            _made[name] = message_factory.GetMessageClass(descriptor)
        else:
            _made[name] = message_factory.MessageFactory(_POOL).GetPrototype(descriptor)
    return _made[name](**fields)


def enum(name: str, prefix: str, word: str) -> int:
    """The number of a word such as "joint" of an enum."""
    values = _POOL.FindEnumTypeByName("relight." + name).values_by_name
    value = values.get(prefix + word.upper())
    if value is None:
        words = ", ".join(sorted(v.removeprefix(prefix).lower() for v in values))
        raise RelightError("ARGUMENT", "%r is none of %s" % (word, words))
    return int(value.number)


def word(name: str, prefix: str, number: int) -> str:
    """The other way; numbers of later daemons stay numbers."""
    values = _POOL.FindEnumTypeByName("relight." + name).values_by_number
    found = values.get(number)
    return str(found.name).removeprefix(prefix).lower() if found else str(number)
