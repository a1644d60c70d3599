"""Parameters: JSON texts by name, kept for the life of the server."""

from __future__ import annotations

import json
from typing import Any

from server.access.permissions import NameFilter
from server.errors import ServiceError
from server.rosapi.question import Answers, Question

# As many as any robot's parameter server has.
MAX_PARAMETERS = 10_000

# Names and values of all parameters together: a robot's description and the settings of all its controllers.
MAX_PARAMETER_BYTES = 16 << 20


class Parameters:
    """Keeps parameters and answers questions about them.

    Args:
        globs: which of them clients may use; None for all.
    """

    def __init__(self, globs: NameFilter | None = None) -> None:
        self._globs = globs or NameFilter("access.params_glob")
        self._values: dict[str, str] = {}
        self._size_bytes = 0
        self.answers: Answers = {
            "set_param": ("rosapi_msgs/srv/SetParam", self._set),
            "get_param": ("rosapi_msgs/srv/GetParam", self._get),
            "has_param": ("rosapi_msgs/srv/HasParam", lambda asked: {"exists": self._name(asked) in self._values}),
            "delete_param": ("rosapi_msgs/srv/DeleteParam", self._delete),
            "get_param_names": ("rosapi_msgs/srv/GetParamNames", self._names),
            # Only ROS 1 has it.
            "search_param": ("rosapi/srv/SearchParam", self._search),
        }

    def _set(self, asked: Question) -> dict[str, Any]:
        name, value = self._name(asked), asked.request["value"]
        if name not in self._values and len(self._values) >= MAX_PARAMETERS:
            raise ServiceError(f"name: there are {MAX_PARAMETERS} parameters already, the limit")
        size_bytes = self._size_bytes + _size_bytes(name, value) - self._kept_bytes(name)
        if size_bytes > MAX_PARAMETER_BYTES:
            raise ServiceError(f"value: {size_bytes} bytes of parameters with it, the limit is {MAX_PARAMETER_BYTES}")
        try:
            json.loads(value)
        # Text that nests too deep ends the parser's recursion.
        except (ValueError, RecursionError) as error:
            raise ServiceError(f"value: must be JSON text: {error}") from error
        self._values[name] = value
        self._size_bytes = size_bytes
        return {}

    def keep(self, name: str, value: str) -> None:
        """Keep a parameter of the server's own, a JSON text, in place of one of this name."""
        self._size_bytes += _size_bytes(name, value) - self._kept_bytes(name)
        self._values[name] = value

    def _get(self, asked: Question) -> dict[str, Any]:
        return {"value": self._values.get(self._name(asked), asked.request["default_value"])}

    def _delete(self, asked: Question) -> dict[str, Any]:
        name = self._name(asked)
        self._size_bytes -= self._kept_bytes(name)
        self._values.pop(name, None)
        return {}

    def _search(self, asked: Question) -> dict[str, Any]:
        """There are no namespaces here: a parameter is found where it is, or not at all."""
        name = self._name(asked)
        return {"global_name": name if name in self._values else ""}

    def _names(self, _asked: Question) -> dict[str, Any]:
        return {"names": sorted(name for name in self._values if self._globs.refusal("parameter", name) is None)}

    def _name(self, asked: Question) -> str:
        """The parameter that is asked about.

        Raises:
            ServiceError: clients may not use it.
        """
        name: str = asked.request["name"]
        refusal = self._globs.refusal("parameter", name)
        if refusal is not None:
            raise ServiceError(refusal)
        return name

    def _kept_bytes(self, name: str) -> int:
        return _size_bytes(name, self._values[name]) if name in self._values else 0


def _size_bytes(name: str, value: str) -> int:
    return len(name.encode()) + len(value.encode())
