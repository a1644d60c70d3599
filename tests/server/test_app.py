import socket
from pathlib import Path

import pytest

from protocol.limits import Limits
from server.app import App
from server.config import RecordingSettings, Settings
from server.errors import ConfigurationError, StartError
from server.features.monitoring import Recording
from server.gateway.settings import ServerSettings
from server.recording.reading import messages
from server.zenoh.settings import ZenohSettings
from tests.conformance.cases import INTERFACES


async def test_settings_reach_graph_and_bridge_and_nobody_is_connected_before_the_rules_of_names_are_known() -> None:
    server = ServerSettings(unregister_timeout_s=3.0, limits=Limits(max_message_bytes=70_000), interfaces=[INTERFACES])
    app = App(Settings(server=server, zenoh=ZenohSettings(mode="peer")))
    assert app.graph._unregister_timeout_s == 3.0
    assert app.graph.message_types.registry.knows("lab_msgs/Sample")
    assert app.bridge is not None
    assert App(Settings()).bridge is None
    assert app.bridge._max_message_bytes == 70_000
    names = [each.name for each in app.features]
    assert names.index("goals of the arms") < names.index("zenoh")
    assert names.index("goals of the arms") < names.index("connections")
    # Other machines hear of the end of goals, and may stop the arm, until it has stopped.
    assert names.index("other machines") < names.index("the arm")


async def test_a_recording_has_what_the_server_latches_when_it_is_made(tmp_path: Path) -> None:
    app = App(Settings(recording=RecordingSettings(file=tmp_path / "run.mcap")))
    recording = next(each for each in app.features if isinstance(each, Recording))
    await recording.open_file()
    await recording.stop()
    recorded = {message.topic for message in messages(tmp_path / "run.mcap")}
    assert {"/arm/state", "/arm/joint_limits"} <= recorded


async def test_settings_or_a_start_that_are_refused_leave_no_recording_behind(tmp_path: Path) -> None:
    for wrong in (
        {"zenoh": {"mode": "peer", "config_file": "/no/such/file"}},
        {"server": {"tls_certificate": "/no/such/file", "tls_key": "/no/such/file"}},
        {"access": {"token_file": "/no/such/file"}},
        {"arm": {"calibration": "/no/such/file"}},
        {"emulator": {"write_log": "/no/such/folder/file"}},
        {"moveit": {"planning_frame": "nowhere"}},
        {"recording": {"file": "/no/such/folder/run.mcap"}},
    ):
        settings = Settings.model_validate({"recording": {"file": tmp_path / "run.mcap"}, **wrong})
        with pytest.raises(ConfigurationError):
            App(settings)
        assert not (tmp_path / "run.mcap").exists(), wrong
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        server = ServerSettings(host="127.0.0.1", port=port)
        app = App(Settings(server=server, recording=RecordingSettings(file=tmp_path / "run.mcap")))
        assert app.features[-1].name == "the recording's file"
        with pytest.raises(StartError) as refused:
            await app.run()
    assert str(refused.value) == f"port in use: 127.0.0.1:{port} is taken by another program; choose one with --port"
    assert not (tmp_path / "run.mcap").exists()
