"""Settings of access: tokens and rights of clients."""

import re
from pathlib import Path
from typing import Literal

from pydantic import Field, SecretStr, field_validator

from server.config_keys import SettingsSection

# Shorter ones can be guessed; longer ones do not fit the headers and addresses that they travel in.
MIN_TOKEN_CHARACTERS, MAX_TOKEN_CHARACTERS = 16, 256

# Every token costs a comparison at every handshake.
MAX_TOKENS = 100

MAX_GLOBS = 1000

# Names stand in logs, and in answers to others.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")
_TOKEN = re.compile(r"[!-~]*")


class AccessSettings(SettingsSection):
    """Clients that may connect, and their rights; see docs/security.md."""

    token: SecretStr | None = None
    """one token with all rights, 16 to 256 characters."""
    admin_tokens: dict[str, SecretStr] = Field(default_factory=dict, max_length=MAX_TOKENS)
    """tokens of clients that may do everything, by name: { ada = "..." }."""
    operate_tokens: dict[str, SecretStr] = Field(default_factory=dict, max_length=MAX_TOKENS)
    """tokens of clients that may move the arm and change the scene, by name."""
    propose_tokens: dict[str, SecretStr] = Field(default_factory=dict, max_length=MAX_TOKENS)
    """tokens of clients whose goals wait for approval, by name."""
    view_tokens: dict[str, SecretStr] = Field(default_factory=dict, max_length=MAX_TOKENS)
    """tokens of clients that may subscribe, plan and stop the arm, by name."""
    token_file: Path | None = None
    """TOML file with the five settings above."""
    without_token: Literal["auto", "none", "view", "propose", "operate", "admin"] = "auto"  # noqa: S105 - a role
    """role of a client without a token; auto is admin if no tokens are set, else none."""
    insecure: bool = False
    """serve an address that others can reach, without tokens."""
    allowed_origins: tuple[str, ...] = Field(default=(), max_length=MAX_GLOBS)
    """origins of other pages that may connect, as in https://app.example.org; * stands for any text, null for a page
    from a file."""
    allowed_hosts: tuple[str, ...] = Field(default=(), max_length=MAX_GLOBS)
    """further names of this server, besides the machine's own."""
    topics_glob: tuple[str, ...] = Field(default=(), max_length=MAX_GLOBS)
    """patterns of topics that clients may use; empty for all."""
    services_glob: tuple[str, ...] = Field(default=(), max_length=MAX_GLOBS)
    """patterns of services and actions that clients may use, besides /rosapi/*; empty for all."""
    control: Literal["lease", "shared"] = "lease"
    """lease: one client controls the arm at a time; shared: all clients."""
    control_idle_s: float = Field(default=10.0, ge=1.0, le=3600.0)
    """time without a request after which the lease ends [s]."""
    goals_per_s: float = Field(default=50.0, ge=0.1, le=1000.0)
    """goals that each client may send, in the long run [1/s]."""
    goal_burst: int = Field(default=100, ge=1, le=10_000)
    """goals that each client may send at once."""

    @field_validator("token")
    @classmethod
    def _token_is_long(cls, value: SecretStr | None) -> SecretStr | None:
        if value is not None:
            check_token(value.get_secret_value())
        return value

    @field_validator("admin_tokens", "operate_tokens", "propose_tokens", "view_tokens")
    @classmethod
    def _tokens_are_long(cls, value: dict[str, SecretStr]) -> dict[str, SecretStr]:
        for name, token in value.items():
            if not _NAME.fullmatch(name):
                raise ValueError(f"the name {name!r} must be 1 to 64 letters, digits and . _ @ -, the first no sign")
            check_token(token.get_secret_value(), f"the token of {name} ")
        return value


def check_token(token: str, whose: str = "") -> None:
    """Check a token against the limits, or raise ValueError, whose text never has it."""
    if not MIN_TOKEN_CHARACTERS <= len(token) <= MAX_TOKEN_CHARACTERS:
        raise ValueError(
            f"{whose}must have {MIN_TOKEN_CHARACTERS} to {MAX_TOKEN_CHARACTERS} characters, not {len(token)}"
        )
    if not _TOKEN.fullmatch(token):
        raise ValueError(f"{whose}must have letters, digits and signs of ASCII alone, and no spaces")
