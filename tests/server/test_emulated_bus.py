from __future__ import annotations

import asyncio
from pathlib import Path

import psutil
import pytest

from robot.servos.bus import Bus
from server.config import EmulatorSettings
from server.emulated_bus import EmulatedBus
from server.errors import StartError


async def test_an_emulated_bus_has_six_servos_until_it_is_closed(tmp_path: Path) -> None:
    emulated = EmulatedBus(EmulatorSettings(write_log=tmp_path / "writes.jsonl"), None)
    port = await emulated.start()
    bus = Bus.open(port)
    assert [bus.ping(servo) for servo in range(1, 7)] == [777] * 6
    bus.close()
    process = psutil.Process(emulated.pid)
    await emulated.close()
    assert not process.is_running()


async def test_an_emulator_that_dies_is_replaced_and_its_port_told() -> None:
    ports: asyncio.Queue[str] = asyncio.Queue()
    emulated = EmulatedBus(EmulatorSettings(), None, ports.put_nowait)
    await emulated.start()
    first = psutil.Process(emulated.pid)
    first.kill()
    bus = Bus.open(await asyncio.wait_for(ports.get(), 5.0))
    assert bus.ping(1) == 777
    bus.close()
    assert emulated.pid != first.pid
    await emulated.close()


async def test_an_emulator_that_does_not_start_is_told(tmp_path: Path) -> None:
    emulated = EmulatedBus(EmulatorSettings(write_log=tmp_path / "no" / "such" / "folder.jsonl"), None)
    with pytest.raises(StartError, match="emulator did not start"):
        await emulated.start()
    await emulated.close()
