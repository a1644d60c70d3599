"""A program that uses an MCP server, steered by lines of JSON: calls and answers in, results and questions out.

In: [number, method of the session, argument, ...], or [0, answer]. Out: [number, result], or [0, question].

Usage: python agent_scenario.py MODE COMMAND ..., or python agent_scenario.py MODE URL, with a mode of mcp's Client, or
``nobody`` where there is no person to ask. The server has the ARMBRIDGE_TOKEN of this program.
"""

import asyncio
import json
import os
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import mcp.types as types
from mcp import ClientSession, StdioServerParameters
from mcp.client.stdio import stdio_client

try:
    from mcp.client import Client
except ImportError:  # before mcp 2
    Client = None


def say(number: int, told: Any) -> None:
    print(json.dumps([number, told]), flush=True)


@asynccontextmanager
async def connected(mode: str, target: list[str], ask: Any) -> AsyncIterator[Any]:
    """A session with the MCP server."""
    own = {key: value for key, value in os.environ.items() if key == "ARMBRIDGE_TOKEN"}
    command = stdio_client(StdioServerParameters(command=target[0], args=target[1:], env=own))
    if Client is None:
        async with command as streams, ClientSession(*streams) as session:
            await session.initialize()
            yield session
    else:
        person, mode = (None, "legacy") if mode == "nobody" else (ask, mode)
        at = target[0] if target[0].startswith("http") else command
        async with Client(at, elicitation_callback=person, mode=mode) as client:
            yield client


async def main(mode: str, *target: str) -> None:
    """Carry out each line until there are no more; several calls may be in progress."""
    answers: asyncio.Queue[bool] = asyncio.Queue()

    async def ask(_context: object, params: types.ElicitRequestParams) -> types.ElicitResult:
        say(0, params.message)
        return types.ElicitResult(action="accept", content={"approve": await answers.get()})

    async def call(session: Any, number: int, method: str, *arguments: Any) -> None:
        result = await getattr(session, method)(*arguments)
        say(number, result.model_dump(mode="json", by_alias=True))

    async with connected(mode, list(target), ask) as session, asyncio.TaskGroup() as calls:
        while line := await asyncio.to_thread(sys.stdin.readline):
            number, *words = json.loads(line)
            if number:
                calls.create_task(call(session, number, *words))
            else:
                answers.put_nowait(words[0])


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
