"""Settings of access: tokens and rights of clients, and the limits of one client's session."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from pydantic import Field, SecretStr, field_validator

from protocol.limits import Limits
from server.config_keys import SettingsSection

# Shorter ones can be guessed; longer ones do not fit the headers and addresses that they travel in.
MIN_TOKEN_CHARACTERS, MAX_TOKEN_CHARACTERS = 16, 256

# Every token costs a comparison at every handshake.
MAX_TOKENS = 100

MAX_GLOBS = 1000

# Names stand in logs, and in answers to others.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")
_TOKEN = re.compile(r"[!-~]*")

_DEFAULT = Limits()


class AccessSettings(SettingsSection):
    """Clients that may connect, and their rights."""

    token: SecretStr | None = None
    """one token with all rights, 16 to 256 characters; None for no such token."""
    admin_tokens: dict[str, SecretStr] = Field(default_factory=dict, max_length=MAX_TOKENS)
    """by name, tokens of those who may do everything."""
    operate_tokens: dict[str, SecretStr] = Field(default_factory=dict, max_length=MAX_TOKENS)
    """by name, tokens of those who may move the arm and change the scene."""
    view_tokens: dict[str, SecretStr] = Field(default_factory=dict, max_length=MAX_TOKENS)
    """by name, tokens of those who may look, plan and stop the arm."""
    token_file: Path | None = None
    """TOML file with the four settings above, apart from the configuration; None for no such file."""
    without_token: Literal["auto", "none", "view", "operate", "admin"] = "auto"  # noqa: S105 - a role
    """what a client may do that shows no token; auto is admin while there are no tokens, and none when there are."""
    insecure: bool = False
    """serve an address that others can reach, without tokens."""
    allowed_origins: tuple[str, ...] = Field(default=(), max_length=MAX_GLOBS)
    """pages of other hosts that may connect, as in https://app.example.org; * in it stands for any text, and null is
    the origin of a page from a file.
    """
    allowed_hosts: tuple[str, ...] = Field(default=(), max_length=MAX_GLOBS)
    """names under which clients may address the server, besides this machine's own."""
    topics_glob: tuple[str, ...] = Field(default=(), max_length=MAX_GLOBS)
    """patterns of topics that clients may use; empty for all."""
    services_glob: tuple[str, ...] = Field(default=(), max_length=MAX_GLOBS)
    """patterns of services and actions that clients may use, besides /rosapi/*; empty for all."""
    params_glob: tuple[str, ...] = Field(default=(), max_length=MAX_GLOBS)
    """patterns of parameters that clients may read and set; empty for all."""
    control: Literal["lease", "shared"] = "lease"
    """lease, one client drives the arm at a time; shared, all may at once."""
    control_idle_s: float = Field(default=10.0, ge=1.0, le=3600.0)
    """the arm is free for others when its driver has asked for nothing for so long [s]."""
    goals_per_s: float = Field(default=50.0, ge=0.1, le=1000.0)
    """goals that each client may send in the long run [1/s]."""
    goal_burst: int = Field(default=100, ge=1, le=10_000)
    """goals that each client may send at once."""

    @field_validator("token")
    @classmethod
    def _token_is_long(cls, value: SecretStr | None) -> SecretStr | None:
        if value is not None:
            check_token(value.get_secret_value())
        return value

    @field_validator("admin_tokens", "operate_tokens", "view_tokens")
    @classmethod
    def _tokens_are_long(cls, value: dict[str, SecretStr]) -> dict[str, SecretStr]:
        check_tokens({name: token.get_secret_value() for name, token in value.items()})
        return value


class SessionSettings(SettingsSection):
    """Limits of one client: sizes, numbers and times."""

    max_message_bytes: int = Field(default=_DEFAULT.max_message_bytes, ge=65_536, le=100_000_000)
    """size of a frame, of an object that comes in several frames, and of all fragments that wait for others [bytes]."""
    max_objects_per_frame: int = Field(default=_DEFAULT.max_objects_per_frame, ge=1, le=100_000)
    """operations in one frame."""
    max_fragments: int = Field(default=_DEFAULT.max_fragments, ge=1, le=1_000_000)
    """fragments of one message, and of all that wait for others."""
    max_fragmented_messages: int = Field(default=_DEFAULT.max_fragmented_messages, ge=1, le=10_000)
    """incomplete messages, whose fragments have not all come."""
    fragment_timeout_s: float = Field(default=_DEFAULT.fragment_timeout_s, ge=1.0, le=86_400.0)
    """a message whose fragments do not come within this time is given up [s]."""
    max_subscriptions: int = Field(default=_DEFAULT.max_subscriptions, ge=1, le=100_000)
    """subscriptions."""
    max_publications: int = Field(default=_DEFAULT.max_publications, ge=1, le=100_000)
    """topics that it publishes."""
    max_offers: int = Field(default=_DEFAULT.max_offers, ge=0, le=100_000)
    """services that it offers, and as many actions."""
    max_calls_in_flight: int = Field(default=_DEFAULT.max_calls_in_flight, ge=1, le=100_000)
    """calls of services that wait for their answers, and as many goals on actions."""
    call_timeout_s: float = Field(default=_DEFAULT.call_timeout_s, ge=0.1, le=3600.0)
    """time to answer of a service that it offers, where the caller names none [s]."""
    max_queued_bytes: int = Field(default=_DEFAULT.max_queued_bytes, ge=65_536, le=10_000_000_000)
    """all that waits for it; of messages of topics the oldest are dropped [bytes]."""
    max_queued_messages: int = Field(default=_DEFAULT.max_queued_messages, ge=100, le=1_000_000)
    """messages of topics that wait for it; beyond, the oldest are dropped."""
    max_topic_delay_s: float = Field(default=_DEFAULT.max_topic_delay_s, ge=0.1, le=3600.0)
    """how far the messages of a topic may be behind, and how long they wait for a client that stands still [s]."""
    max_queued_request_bytes: int = Field(default=_DEFAULT.max_queued_request_bytes, ge=65_536, le=100_000_000)
    """calls and goals that wait for a slow client; those beyond fail [bytes]."""
    max_queued_reply_bytes: int = Field(default=_DEFAULT.max_queued_reply_bytes, ge=65_536, le=100_000_000)
    """answers that wait for a slow client; beyond, it is disconnected [bytes]."""

    def limits(self) -> Limits:
        """Return the limits as the protocol takes them."""
        return Limits(**self.model_dump())


def check_tokens(tokens: Mapping[str, str]) -> None:
    """Check tokens and their names against the limits."""
    for name, token in tokens.items():
        if not _NAME.fullmatch(name):
            raise ValueError(f"the name {name!r} must be 1 to 64 letters, digits and . _ @ -, the first no sign")
        check_token(token, f"the token of {name} ")


def check_token(token: str, whose: str = "") -> None:
    """Check a token against the limits.

    Raises:
        ValueError: it is no good; the text never has it.
    """
    if not MIN_TOKEN_CHARACTERS <= len(token) <= MAX_TOKEN_CHARACTERS:
        raise ValueError(
            f"{whose}must have {MIN_TOKEN_CHARACTERS} to {MAX_TOKEN_CHARACTERS} characters, not {len(token)}"
        )
    if not _TOKEN.fullmatch(token):
        raise ValueError(f"{whose}must have letters, digits and signs of ASCII alone, and no spaces")
