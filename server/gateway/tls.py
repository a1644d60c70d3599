"""The server's certificate, and its replacement while the server runs."""

from __future__ import annotations

import logging
import ssl
from collections.abc import Callable
from pathlib import Path

from server.access.rate_limits import LogLimiter
from server.errors import ConfigurationError

log = logging.getLogger("armbridge.gateway")

CERTIFICATE, KEY = "server.tls_certificate", "server.tls_key"

_LOCKED = "the key has a passphrase, which nobody can enter; `openssl pkey -in KEY -out NEW` takes it off"


class Tls:
    """A certificate with its key.

    Args:
        certificate: PEM file, with the certificates that lead to its issuer.
        key: PEM file.

    Attributes:
        context: context of the listening sockets, the same as long as the server runs; each handshake gets the
            certificate that was read last.

    Raises:
        ConfigurationError: the files cannot be used.
    """

    def __init__(self, certificate: Path, key: Path) -> None:
        self._certificate = certificate
        self._key = key
        self._log = LogLimiter(log, burst=1)
        self._latest = self.context = self._read()
        # Called in every handshake, also when the client names no server.
        self.context.sni_callback = self._use_latest
        self.context.sslobject_class = _handshakes(self._tell_plain_text)

    def reload(self) -> None:
        """Read the files again; files that cannot be used change nothing and are named in the log."""
        try:
            self._latest = self._read()
        except ConfigurationError as error:
            log.warning("the certificate stays as it was: %s", error)
        else:
            log.info("certificate read again: %s", self._certificate)

    def _use_latest(self, connection: ssl.SSLObject, _name: str | None, _context: ssl.SSLContext) -> None:
        connection.context = self._latest

    def _tell_plain_text(self) -> None:
        """Tell once of a client that does not encrypt: asyncio closes its connection without a word."""
        line = "refused: a client speaks ws:// or http://, and here is wss:// and https://"
        self._log.write(logging.WARNING, line, ("tls", "plain text"))

    def _read(self) -> ssl.SSLContext:
        for setting, file in ((CERTIFICATE, self._certificate), (KEY, self._key)):
            _check_readable(setting, file)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.set_alpn_protocols(["http/1.1"])
        asked: list[bool] = []

        def passphrase() -> str:
            asked.append(True)
            return ""

        try:
            context.load_cert_chain(self._certificate, self._key, passphrase)
        except (ssl.SSLError, OSError, ValueError) as error:
            raise ConfigurationError(self._reason(error, asked_for_passphrase=bool(asked))) from error
        return context

    def _reason(self, error: Exception, *, asked_for_passphrase: bool) -> str:
        if asked_for_passphrase:
            return f"{KEY}: {self._key}: {_LOCKED}"
        if isinstance(error, ssl.SSLError) and error.reason == "KEY_VALUES_MISMATCH":
            return f"{KEY}: {self._key} is not the key of the certificate in {self._certificate} ({CERTIFICATE})"
        for setting, file, kind in ((CERTIFICATE, self._certificate, "CERTIFICATE"), (KEY, self._key, "PRIVATE KEY")):
            if f"{kind}-----" not in file.read_text(errors="replace"):
                return f"{setting}: {file} has no {kind} in PEM format"
        return f"{CERTIFICATE} {self._certificate} and {KEY} {self._key} cannot be used: {error}"


def _handshakes(on_plain_text: Callable[[], None]) -> type[ssl.SSLObject]:
    """Return the class of a context's connections; it reports a client that begins with HTTP instead of TLS."""

    class Handshake(ssl.SSLObject):
        def do_handshake(self) -> None:
            try:
                super().do_handshake()
            except ssl.SSLError as error:
                if error.reason == "HTTP_REQUEST":
                    on_plain_text()
                raise

    return Handshake


def _check_readable(setting: str, file: Path) -> None:
    try:
        file.open("rb").close()
    except OSError as error:
        raise ConfigurationError(f"{setting}: {file} cannot be read: {error.strerror or error}") from error
