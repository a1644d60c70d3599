from __future__ import annotations

import contextlib
import re
import shlex
import ssl
from pathlib import Path

import pytest

from server.errors import ConfigurationError
from server.gateway.entrance.tls import Tls
from tests.helpers.certificates import Pair, make_pair, openssl
from tests.helpers.server import ROOT


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Pair, Pair]:
    return make_pair(tmp_path_factory.mktemp("one")), make_pair(tmp_path_factory.mktemp("other"))


def test_nothing_older_than_tls_1_2_is_spoken(pairs: tuple[Pair, Pair]) -> None:
    assert Tls(*pairs[0]).context.minimum_version is ssl.TLSVersion.TLSv1_2


def test_a_key_of_another_certificate_is_named(pairs: tuple[Pair, Pair]) -> None:
    one, other = pairs
    with pytest.raises(ConfigurationError) as refused:
        Tls(one.certificate, other.key)
    assert str(refused.value) == (
        f"server.tls_key: {other.key} is not the key of the certificate in {one.certificate} (server.tls_certificate)"
    )


@pytest.mark.parametrize("missing", ["certificate", "key"])
def test_a_file_that_cannot_be_read_is_named(pairs: tuple[Pair, Pair], missing: str) -> None:
    pair = pairs[0]._replace(**{missing: Path("/nowhere.pem")})
    with pytest.raises(ConfigurationError, match=f"server.tls_{missing}: /nowhere.pem cannot be read: No such file"):
        Tls(*pair)


@pytest.mark.parametrize(
    ("which", "kind"), [("certificate", "CERTIFICATE"), ("key", "PRIVATE KEY")], ids=["certificate", "key"]
)
def test_a_file_of_something_else_is_named(pairs: tuple[Pair, Pair], which: str, kind: str, tmp_path: Path) -> None:
    (tmp_path / "x.pem").write_bytes(b"\xff\x00 nothing of that kind")
    pair = pairs[0]._replace(**{which: tmp_path / "x.pem"})
    with pytest.raises(ConfigurationError, match=f"server.tls_{which}: .*x.pem has no {kind} in PEM format"):
        Tls(*pair)


def test_a_key_with_a_passphrase_is_refused_and_nobody_is_asked_for_it(
    pairs: tuple[Pair, Pair], tmp_path: Path
) -> None:
    locked = tmp_path / "locked.pem"
    openssl("pkey", "-in", str(pairs[0].key), "-aes256", "-passout", "pass:secret", "-out", str(locked))
    with pytest.raises(ConfigurationError, match="the key has a passphrase") as refused:
        Tls(pairs[0].certificate, locked)
    assert "openssl pkey -in KEY -out NEW" in str(refused.value)


def certificate_shown(tls: Tls) -> bytes:
    """The certificate, in DER, that a client gets that names no server."""
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = trusting.wrap_bio(to_client, to_server)
    server = tls.context.wrap_bio(to_server, to_client, server_side=True)
    for side in (client, server, client, server):
        with contextlib.suppress(ssl.SSLWantReadError):
            side.do_handshake()
    return client.getpeercert(binary_form=True) or b""


def test_a_new_pair_is_taken_and_a_broken_one_is_not(
    pairs: tuple[Pair, Pair], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    one, other = pairs
    used = Pair(tmp_path / "certificate.pem", tmp_path / "key.pem")
    used.certificate.write_bytes(one.certificate.read_bytes())
    used.key.write_bytes(one.key.read_bytes())
    tls = Tls(*used)
    first = certificate_shown(tls)
    assert first == ssl.PEM_cert_to_DER_cert(one.certificate.read_text())
    used.certificate.write_bytes(other.certificate.read_bytes())
    tls.reload()
    assert certificate_shown(tls) == first
    assert "the certificate stays as it was: server.tls_key:" in caplog.text
    used.key.write_bytes(other.key.read_bytes())
    tls.reload()
    assert certificate_shown(tls) == ssl.PEM_cert_to_DER_cert(other.certificate.read_text())


def test_the_command_of_the_security_page_makes_a_pair(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "security.md").read_text()
    found = re.search(r"openssl (req (?:.|\\\n)*?)\n```", text)
    assert found is not None
    words = shlex.split(found[1].replace("\\\n", " "))
    openssl(*(str(tmp_path / word) if word.startswith("arm.") else word for word in words))
    Tls(tmp_path / "arm.pem", tmp_path / "arm.key")
