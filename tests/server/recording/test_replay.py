from __future__ import annotations

import asyncio
import re
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from server.access.settings import AccessSettings
from server.config import ServerSettings
from server.errors import RecordingError
from server.recording.player import Player
from server.recording.replay import Replay, ReplayOptions
from tests.helpers.client import frame_client
from tests.helpers.recorded import record, record_killed, text

SERVING = re.compile(r"ws://127\.0\.0\.1:(\d+)")


@pytest.fixture
def options(tmp_path: Path) -> ReplayOptions:
    path = record(tmp_path / "run.mcap", [text(number) for number in range(3)])
    return ReplayOptions(path, ServerSettings(port=0), AccessSettings(), rate=100.0, delay_s=0.0, loop=False)


async def url(caplog: pytest.LogCaptureFixture) -> str:
    """Where the replay is offered, from its log."""
    async with asyncio.timeout(30.0):
        while not (found := SERVING.search(caplog.text)):
            await asyncio.sleep(0.01)
    return found[0]


async def test_it_ends_with_the_recording(options: ReplayOptions, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    async with asyncio.timeout(30.0):
        await Replay(options).run()
    assert "1 topics, 3 messages, 2.0 s" in caplog.text
    assert "replay ended: 3 messages published, 0 could not be read" in caplog.text


async def test_a_client_gets_what_was_recorded(
    options: ReplayOptions, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level("INFO")
    # In place of a delay, which a client on a busy machine may miss.
    subscribed, play = asyncio.Event(), Player.play

    async def play_when_subscribed(player: Player) -> None:
        await subscribed.wait()
        await play(player)

    monkeypatch.setattr(Player, "play", play_when_subscribed)
    replay = Replay(options)
    playing = asyncio.create_task(replay.run())
    async with frame_client(await url(caplog)) as client:
        await client.subscribe("/t", "std_msgs/String")
        async with asyncio.timeout(30.0):
            while not replay._graph.subscribers("/t"):
                await asyncio.sleep(0.005)
        subscribed.set()
        heard = await client.wait_for("/t", lambda messages: len(messages) >= 3)
    await playing
    assert [message["data"] for message in heard] == ["0", "1", "2"]


async def test_a_loop_begins_again_until_a_signal_ends_it(
    options: ReplayOptions, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    playing = asyncio.create_task(Replay(replace(options, loop=True)).run())
    async with frame_client(await url(caplog)) as client:
        await client.subscribe("/t", "std_msgs/String")
        await client.wait_for("/t", lambda messages: [each["data"] for each in messages].count("2") >= 2)
        signal.raise_signal(signal.SIGTERM)
        await asyncio.wait_for(playing, 30.0)
    assert "replay ended" in caplog.text


async def test_a_recording_that_was_not_ended_is_played_and_told(
    options: ReplayOptions, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    record_killed(options.path, [[text(0)], [text(1)]])
    await Replay(options).run()
    assert "not ended in good order" in caplog.text
    assert "2 messages published" in caplog.text


async def test_a_file_that_disappears_is_an_error(options: ReplayOptions) -> None:
    options.path.unlink()
    with pytest.raises(RecordingError, match="No such file"):
        await Replay(options).run()
