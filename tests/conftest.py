"""Fixtures and settings of all tests."""

import asyncio
import gc
import os
import signal
import tempfile
from collections.abc import Callable, Generator, Iterator

import pytest
from hypothesis import settings

# Imported before any test imports websockets: sets what that package reads when it is imported.
import server  # noqa: F401
from harness.server import FAST, RunningServer
from tests.helpers.clock import SteppedLoop
from tests.helpers.resources import EXAMPLES_OF_EXPLORING

# No deadline: how long an example takes depends on the machine and on what else it does; no test is about that.
# The same examples each time, so that a change fails for what it changed; `explore` draws others, and more.
settings.register_profile("same", max_examples=25, deadline=None, derandomize=True)
settings.register_profile("explore", max_examples=EXAMPLES_OF_EXPLORING, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE") or "same")

# MuJoCo reads it when any test imports it first.
os.environ.setdefault("MUJOCO_GL", "egl")


# What servers in the tests' own processes keep, and those that a test starts by itself, goes nowhere near the user's.
_DATA = tempfile.TemporaryDirectory(prefix="armbridge")


def pytest_configure() -> None:
    """Keep the user's data directory out of the tests, and have signals mean the same however these were started."""
    os.environ["XDG_DATA_HOME"] = _DATA.name
    # A shell has what it starts in the background ignore SIGINT, and nohup SIGHUP; programs of a test inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_unconfigure() -> None:
    """Remove what was kept."""
    _DATA.cleanup()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect the tests without the garbage collector: nearly all that collecting makes stays."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish() -> None:
    """Hide the collected tests from the garbage collector, which would spend seconds on their million objects."""
    gc.collect()
    gc.freeze()
    # Reports of tests stay as well, so the oldest generation is looked through a tenth as often as by default.
    gc.set_threshold(700, 10, 100)


def pytest_sessionfinish() -> None:
    """Let what was hidden be freed, or nanobind prints what was leaked."""
    gc.unfreeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol() -> Generator[None, object, object]:
    """Give each test the handlers of signals that the one before had: emulators and loops that fail leave theirs."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        return (yield)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def pytest_asyncio_loop_factories(item: pytest.Item) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Choose the event loop of a test, by its mark ``stepped_time``."""
    return {"stepped": SteppedLoop} if item.get_closest_marker("stepped_time") else {"real": asyncio.new_event_loop}


@pytest.fixture(scope="session")
def simulated_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    """Server whose simulated arm moves as fast as it can, for tests that leave the arm wherever it comes to rest."""
    states = tmp_path_factory.mktemp("simulated") / "named_states.json"
    with RunningServer(settings={**FAST, "ARMBRIDGE_GOALS__NAMED_STATES_FILE": str(states)}) as running:
        yield running


# The fixtures of emulated servos serve several folders.
pytest_plugins = ["tests.helpers.servo_fixtures"]
pytest.register_assert_rewrite("tests.helpers.arm_contract")


def pytest_addoption(parser: pytest.Parser) -> None:
    """The one option that moves metal; tests/helpers/arm_contract.py says what it does and how far it goes."""
    parser.addoption(
        "--arm",
        metavar="PORT,CALIBRATION",
        help="run the arm's contract on a real arm as well: serial port, and lerobot calibration (id or file)",
    )
