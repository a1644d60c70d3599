"""Certificates for tests, made by openssl."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import NamedTuple


class Pair(NamedTuple):
    """A certificate with its key, both PEM files."""

    certificate: Path
    key: Path


def make_pair(folder: Path, name: str = "localhost") -> Pair:
    """A new certificate for this machine, signed by itself."""
    folder.mkdir(parents=True, exist_ok=True)
    pair = Pair(folder / "certificate.pem", folder / "key.pem")
    openssl(
        *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2"),
        *("-keyout", str(pair.key), "-out", str(pair.certificate), "-subj", f"/CN={name}"),
        *("-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"),
    )
    return pair


def make_signed_pair(folder: Path, authority: Pair) -> Pair:
    """A new certificate for this machine, signed by another one."""
    folder.mkdir(parents=True, exist_ok=True)
    pair, request, names = Pair(folder / "certificate.pem", folder / "key.pem"), folder / "csr.pem", folder / "names"
    names.write_text("subjectAltName=DNS:localhost,IP:127.0.0.1\n")
    openssl(
        *("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
        *("-keyout", str(pair.key), "-out", str(request), "-subj", f"/CN={folder.name}"),
    )
    openssl(
        *("x509", "-req", "-in", str(request), "-days", "2", "-extfile", str(names), "-out", str(pair.certificate)),
        *("-CA", str(authority.certificate), "-CAkey", str(authority.key), "-CAcreateserial"),
    )
    return pair


def openssl(*arguments: str) -> None:
    """Call openssl."""
    subprocess.run(["openssl", *arguments], check=True, capture_output=True, timeout=30)
