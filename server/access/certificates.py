"""Certificates that browsers on other machines and phones accept: a local authority, and what it signs for this host.

Apple's devices take a server's certificate that is valid for 398 days at most (825 of an authority that the user has
added), has the purpose serverAuth and names the host in subjectAltName (support.apple.com/en-us/103769, 102028).
Android's and desktop browsers ask for no more.
"""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from robot.files import locked, replace
from server.errors import ConfigurationError

# A day less than what phones take, which count the first second as well.
VALID_DAYS = 397
AUTHORITY_VALID_DAYS = 3650

# Clocks of phones differ from the server's; a certificate that begins now would not be valid there yet.
_CLOCK_MARGIN = timedelta(hours=1)

# Each name costs some bytes in every handshake.
MAX_NAMES = 64

# RFC 1035, section 2.3.4, and RFC 5280, upper bound of a common name.
_MAX_NAME_CHARACTERS = 253
_MAX_COMMON_NAME_CHARACTERS = 64


class CertificateFiles:
    """Files of the local authority, which phones are to trust, and of the server.

    ``certificate`` is the server's certificate, followed by the authority's, in PEM.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.authority = directory / "armbridge-authority.crt"
        self.authority_key = directory / "armbridge-authority.key"
        self.certificate = directory / "server.pem"
        self.key = directory / "server.key"


@dataclass(frozen=True)
class IssuedCertificate:
    """Outcome of :func:`issue_certificate`."""

    names: Sequence[str]
    ends: datetime
    authority_name: str
    fingerprint: str
    made_authority: bool


@dataclass(frozen=True)
class _Pair:
    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


def issue_certificate(files: CertificateFiles, names: Iterable[str], now: datetime | None = None) -> IssuedCertificate:
    """Make the server's certificate, and the authority before it unless it is good; raises ConfigurationError."""
    now = datetime.now(UTC) if now is None else now
    wanted = list(dict.fromkeys(map(_general_name, names)))
    if not 1 <= len(wanted) <= MAX_NAMES:
        raise ConfigurationError(f"--name: a certificate has 1 to {MAX_NAMES} names and addresses, not {len(wanted)}")
    try:
        files.directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        with locked(files.authority):
            return _issue(files, wanted, now)
    except OSError as error:
        raise ConfigurationError(f"{files.directory}: the certificate cannot be kept there: {error}") from error


def _issue(files: CertificateFiles, wanted: Sequence[x509.GeneralName], now: datetime) -> IssuedCertificate:
    authority = _load(files.authority, files.authority_key)
    made_authority = authority is None or authority.certificate.not_valid_after_utc < now + timedelta(days=VALID_DAYS)
    if authority is None or made_authority:
        authority = _make_authority(now)
        replace(files.authority_key, _key_pem(authority.key), 0o600)
        replace(files.authority, _pem(authority.certificate), 0o644)
    made = _make_certificate(authority, wanted, now)
    replace(files.key, _key_pem(made.key), 0o600)
    replace(files.certificate, _pem(made.certificate) + _pem(authority.certificate), 0o644)
    return IssuedCertificate(
        [str(name.value) for name in wanted],
        made.certificate.not_valid_after_utc,
        str(authority.certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value),
        authority.certificate.fingerprint(SHA256()).hex(" ").upper(),
        made_authority,
    )


def _general_name(name: str) -> x509.GeneralName:
    text = name.strip().lower().removesuffix(".")
    try:
        return x509.IPAddress(ip_address(text.strip("[]")))
    except ValueError:
        pass
    labels = text.removeprefix("*.").split(".")
    good = all(
        0 < len(label) < _MAX_COMMON_NAME_CHARACTERS and label.isascii() and label.replace("-", "").isalnum()
        for label in labels
    )
    if not good or len(text) > _MAX_NAME_CHARACTERS:
        raise ConfigurationError(f"--name: {name[:80]!r} is neither a host name nor an IP address")
    return x509.DNSName(text)


def _make_authority(now: datetime) -> _Pair:
    key = ec.generate_private_key(ec.SECP256R1())
    host = os.uname().nodename.partition(".")[0][:40] or "this machine"
    name = _named(f"armbridge authority of {host}")
    return _Pair(_builder(name, name, key, now, AUTHORITY_VALID_DAYS, is_authority=True).sign(key, SHA256()), key)


def _make_certificate(authority: _Pair, names: Sequence[x509.GeneralName], now: datetime) -> _Pair:
    key = ec.generate_private_key(ec.SECP256R1())
    subject = _named(str(names[0].value)[:_MAX_COMMON_NAME_CHARACTERS])
    built = (
        _builder(subject, authority.certificate.subject, key, now, VALID_DAYS, is_authority=False)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key()), critical=False)
    )
    return _Pair(built.sign(authority.key, SHA256()), key)


def _named(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    now: datetime,
    days: int,
    *,
    is_authority: bool,
) -> x509.CertificateBuilder:
    begins = now - _CLOCK_MARGIN
    usage = x509.KeyUsage(
        digital_signature=not is_authority,
        key_cert_sign=is_authority,
        crl_sign=is_authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begins)
        .not_valid_after(begins + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(x509.BasicConstraints(is_authority, 0 if is_authority else None), critical=True)
        .add_extension(usage, critical=True)
    )


def _load(certificate: Path, key: Path) -> _Pair | None:
    """Read a certificate with its key; None for files that are missing, of no use, or not of each other."""
    try:
        read = x509.load_pem_x509_certificate(certificate.read_bytes())
        read_key = load_pem_private_key(key.read_bytes(), None)
    except (FileNotFoundError, ValueError, TypeError):
        return None
    if not isinstance(read_key, ec.EllipticCurvePrivateKey):
        return None
    return _Pair(read, read_key) if read_key.public_key() == read.public_key() else None


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(Encoding.PEM)


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
