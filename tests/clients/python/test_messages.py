"""The client's message types are the server's."""

import sys

from harness.server import ROOT
from tests.helpers.programs import run

CLIENT = ROOT / "clients" / "python"


def test_the_committed_message_types_are_generated_from_the_servers_tables() -> None:
    program = "import generate_messages; print(generate_messages.generated(), end='')"
    done = run(sys.executable, "-c", program, env={"PYTHONPATH": f"{CLIENT}:{ROOT}"})
    assert done.stdout == (CLIENT / "armbridge_client" / "messages.py").read_text(), (
        f"run PYTHONPATH=. python clients/python/generate_messages.py\n{done.stderr}"
    )
