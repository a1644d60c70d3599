"""Write ``armbridge.d.ts`` from the server's type tables, in the repository of the server."""

from __future__ import annotations

from pathlib import Path

from clients.python.generate_messages import ACTIONS, MESSAGES, SERVICES, class_name
from protocol.registry import Field, MessageType, Registry

TARGET = Path(__file__).with_name("armbridge.d.ts")
HEAD = """\
// Types of armbridge's messages as rosbridge writes them in JSON, made by generate_types.py: do not edit.
//
// uint8[] is base64 text. NaN and infinite numbers are null. A message that you send may leave fields out.
"""


class Generator:
    """Interfaces for message types, each behind the interfaces of its fields."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._interfaces: dict[str, str] = {}

    def text(self) -> str:
        """Return the text of the declarations."""
        registry = self._registry
        messages = [f"  {registry.canonical(name)!r}: {self._add(registry.message(name))};" for name in MESSAGES]
        services = [
            f"  {registry.canonical(name, 'srv')!r}: {{ request: {self._add(service.request)}; "
            f"response: {self._add(service.response)} }};"
            for name in SERVICES
            for service in [registry.service(name)]
        ]
        actions = [
            f"  {registry.canonical(name, 'action')!r}: {{ goal: {self._add(action.goal)}; "
            f"result: {self._add(action.result)}; feedback: {self._add(action.feedback)} }};"
            for name in ACTIONS
            for action in [registry.action(name)]
        ]
        tables = (("Messages", messages), ("Services", services), ("Actions", actions))
        listed = [
            "\n".join((f"export interface {name} {{", *lines, "}", "")).replace("'", '"') for name, lines in tables
        ]
        return "\n".join((HEAD, *self._interfaces.values(), *listed))

    def _add(self, message: MessageType) -> str:
        name = class_name(message.name)
        if message.name not in self._interfaces:
            lines = [f"  {each.name}: {self._type(each)};" for each in message.fields]
            self._interfaces[message.name] = "\n".join(
                (f"/** {message.name} */", f"export interface {name} {{", *lines, "}", "")
            )
        return name

    def _type(self, row: Field) -> str:
        if row.array is not None and row.base in ("uint8", "byte"):
            return "string"
        if not row.primitive:
            declared = self._add(self._registry.message(row.base))
        else:
            declared = {"bool": "boolean", "string": "string", "wstring": "string"}.get(row.base, "number")
        return declared if row.array is None else f"{declared}[]"


def generated() -> str:
    """Return the text of the declarations."""
    return Generator(Registry.load()).text()


if __name__ == "__main__":
    TARGET.write_text(generated())
