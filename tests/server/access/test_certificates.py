import asyncio
import ssl
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from server.access.certificates import CertificateFiles, issue_certificate
from server.errors import ConfigurationError
from server.gateway.settings import ServerSettings
from tests.helpers.gateway import listening

NOW = datetime(2026, 5, 1, 12, tzinfo=UTC)
NAMES = ("arm.local", "127.0.0.1", "::1")


@pytest.fixture
def files(tmp_path: Path) -> CertificateFiles:
    return CertificateFiles(tmp_path / "armbridge" / "tls")


def leaf(files: CertificateFiles) -> x509.Certificate:
    return x509.load_pem_x509_certificates(files.certificate.read_bytes())[0]


def of(kind: type, certificate: x509.Certificate) -> Any:
    """An extension of a certificate."""
    return certificate.extensions.get_extension_for_class(kind)


def test_the_certificate_has_what_phones_ask_for(files: CertificateFiles) -> None:
    outcome = issue_certificate(files, NAMES, NOW)
    certificate = leaf(files)
    names = of(x509.SubjectAlternativeName, certificate).value
    assert names.get_values_for_type(x509.DNSName) == ["arm.local"]
    assert [str(each) for each in names.get_values_for_type(x509.IPAddress)] == ["127.0.0.1", "::1"]
    assert [each.value for each in certificate.subject] == ["arm.local"]
    assert list(of(x509.ExtendedKeyUsage, certificate).value) == [ExtendedKeyUsageOID.SERVER_AUTH]
    assert certificate.not_valid_after_utc - certificate.not_valid_before_utc == timedelta(days=397)
    # Clocks of phones may be an hour late.
    assert certificate.not_valid_before_utc == NOW - timedelta(hours=1)
    assert outcome.ends == certificate.not_valid_after_utc
    assert not of(x509.BasicConstraints, certificate).value.ca


def test_the_authority_signs_servers_alone_and_keys_are_of_the_user_alone(files: CertificateFiles) -> None:
    issue_certificate(files, NAMES, NOW)
    authority = x509.load_pem_x509_certificate(files.authority.read_bytes())
    assert authority.not_valid_after_utc - authority.not_valid_before_utc == timedelta(days=3650)
    constraints = of(x509.BasicConstraints, authority)
    assert constraints.value == x509.BasicConstraints(ca=True, path_length=0)
    for certificate, signs in ((authority, True), (leaf(files), False)):
        usage = of(x509.KeyUsage, certificate)
        assert constraints.critical is usage.critical is True
        assert (usage.value.key_cert_sign, usage.value.crl_sign, usage.value.digital_signature) == (
            signs,
            signs,
            not signs,
        )
    kept = {files.authority_key: 0o600, files.key: 0o600, files.directory: 0o700}
    kept |= {files.authority: 0o644, files.certificate: 0o644}
    assert [path.name for path in kept][:2] == ["armbridge-authority.key", "server.key"]
    assert {path: stat.S_IMODE(path.stat().st_mode) for path in kept} == kept


async def test_a_client_that_knows_the_authority_alone_trusts_the_server(files: CertificateFiles) -> None:
    issue_certificate(files, NAMES)
    settings = ServerSettings(port=0, tls_certificate=files.certificate, tls_key=files.key)
    async with listening(settings) as listener:
        # As strict as RFC 5280 has it, which Python's default is from 3.13 on.
        context = ssl.create_default_context(cafile=files.authority)
        context.verify_flags |= ssl.VERIFY_X509_STRICT
        for name in ("arm.local", "127.0.0.1"):
            _, writer = await asyncio.open_connection("127.0.0.1", listener.port, ssl=context, server_hostname=name)
            writer.close()
            await writer.wait_closed()
        with pytest.raises(ssl.SSLCertVerificationError, match="not valid for"):
            await asyncio.open_connection("127.0.0.1", listener.port, ssl=context, server_hostname="other.local")


def test_the_same_authority_signs_the_next_one_unless_it_would_end_before_it(files: CertificateFiles) -> None:
    first = issue_certificate(files, NAMES, NOW)
    second = issue_certificate(files, (*NAMES, "10.0.0.7"), NOW + timedelta(days=1))
    assert (first.made_authority, second.made_authority) == (True, False)
    assert second.fingerprint == first.fingerprint
    assert second.names == [*NAMES, "10.0.0.7"]
    assert leaf(files).not_valid_before_utc > NOW
    later = issue_certificate(files, NAMES, NOW + timedelta(days=3600))
    assert (later.made_authority, later.fingerprint == first.fingerprint) == (True, False)


@pytest.mark.parametrize("damaged", ["authority", "authority_key"])
def test_a_damaged_authority_is_replaced(files: CertificateFiles, damaged: str) -> None:
    issue_certificate(files, NAMES, NOW)
    getattr(files, damaged).write_text("nothing")
    assert issue_certificate(files, NAMES, NOW).made_authority
    leaf(files).verify_directly_issued_by(x509.load_pem_x509_certificate(files.authority.read_bytes()))


# RFC 1035, section 2.3.4: a name has 253 characters at most, and each part of it 63.
LONGEST = ".".join(["x" * 63] * 3 + ["x" * 61])


@pytest.mark.parametrize(
    "name", ["", "two words", "a_b", "https://arm.local", "a..b", "x" * 64, f"{LONGEST}x", "10.0.0.2:9090"]
)
def test_a_name_that_is_none_and_no_names_or_too_many_are_refused(files: CertificateFiles, name: str) -> None:
    with pytest.raises(ConfigurationError, match="neither a host name nor an IP address"):
        issue_certificate(files, [name], NOW)
    for count in (0, 65):
        with pytest.raises(ConfigurationError, match=f"has 1 to 64 names and addresses, not {count}"):
            issue_certificate(files, [f"10.0.0.{number}" for number in range(count)], NOW)
    assert not files.directory.exists()


def test_names_are_taken_as_they_are_written_in_addresses_of_pages(files: CertificateFiles) -> None:
    issue_certificate(files, [f"10.0.0.{number}" for number in range(64)], NOW)
    for name, taken in ((LONGEST, LONGEST), (" *.Arm-1.local. ", "*.arm-1.local"), ("[::1]", "::1")):
        assert issue_certificate(files, [name], NOW).names == [taken]
        assert [each.value for each in leaf(files).subject] == [taken[:64]]


def test_a_folder_that_is_a_file_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="the certificate cannot be kept there"):
        issue_certificate(CertificateFiles(tmp_path / "file" / "tls"), NAMES, NOW)
