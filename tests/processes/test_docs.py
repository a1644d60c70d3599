"""Programs, commands and messages of the docs, run against a server and sent to it."""

import json
import re
import shlex
import sys

import pytest
from websockets.sync.client import connect

from harness.server import CLIENT_ENVIRONMENT, ROOT, RunningServer
from harness.waiting import TIMEOUT_S
from tests.helpers.programs import run
from tests.test_docs import EXAMPLES, PAGES
from tests.test_readme import blocks

SERVER_PORT = "9090"

# Pages whose JSON blocks hold only messages to the server; the page of the protocol also shows answers.
SENT = ("engines.md", "goals.md", "operations.md")

PROGRAMS = [(page.name, block) for page in PAGES for block in blocks(page, "python")]


@pytest.mark.parametrize("program", [block for _, block in PROGRAMS], ids=[page for page, _ in PROGRAMS])
def test_a_python_program_of_the_docs_runs(program: str, simulated_server: RunningServer) -> None:
    assert SERVER_PORT in program
    program = program.replace(SERVER_PORT, str(simulated_server.port))
    done = run(sys.executable, "-c", program, env=CLIENT_ENVIRONMENT)
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.parametrize("command", EXAMPLES)
def test_a_command_with_an_example_succeeds(command: str, simulated_server: RunningServer) -> None:
    _, *arguments = shlex.split(command)
    # The last of an option that is given twice counts.
    done = run(sys.executable, *arguments, "--url", simulated_server.url, env=CLIENT_ENVIRONMENT)
    assert done.returncode == 0, done.stdout + done.stderr


CURL = [line for line in "".join(blocks(ROOT / "docs" / "protocol.md", "sh")).splitlines() if line.startswith("curl ")]


@pytest.mark.parametrize("command", CURL)
def test_a_goal_of_the_page_about_http_is_carried_out(command: str, simulated_server: RunningServer) -> None:
    words = shlex.split(command.replace(SERVER_PORT, str(simulated_server.port)).replace("$TOKEN", "any-token"))
    done = run(*words, "--silent", "--show-error", "--fail-with-body")
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(done.stdout)["success"]


# What roslib sends for the topics of its example.
OF_ROSLIB = [
    json.dumps({"op": op, "topic": name, "type": type_name})
    for name, type_name in re.findall(
        r"name: \"(/\w+)\", messageType: \"([\w/]+)\"", (ROOT / "examples" / "roslib_page.html").read_text()
    )
    for op in ("advertise", "subscribe")
]


@pytest.mark.parametrize("page", SENT)
def test_the_messages_of_a_page_are_taken_without_complaint(page: str, simulated_server: RunningServer) -> None:
    frames = [line for block in blocks(ROOT / "docs" / page, "json") for line in block.splitlines()]
    assert frames
    assert OF_ROSLIB
    frames += OF_ROSLIB if page == "engines.md" else []
    calls = {frame["id"] for frame in map(json.loads, frames) if frame["op"] == "call_service"}
    complaints = []
    with connect(f"ws://127.0.0.1:{simulated_server.port}") as client:

        def call_and_wait(service: str, waited_for: set[str]) -> None:
            client.send(json.dumps({"op": "call_service", "service": service, "id": service}))
            left = {service, *waited_for}
            while left:
                operation = json.loads(client.recv(timeout=TIMEOUT_S))
                refused = operation["op"] == "service_response" and not operation["result"]
                if operation["op"] == "status" or refused:
                    complaints.append(operation)
                left.discard(operation.get("id"))
                calls.discard(operation.get("id"))

        client.send(json.dumps({"op": "set_level", "level": "warning"}))
        for frame in frames:
            client.send(frame)
            # A stop overtakes what waits: the frame is carried out before the next is sent, as where a person sends.
            call_and_wait("/rosapi/get_time", set())
        call_and_wait("/arm/stop", calls)
    assert complaints == []
