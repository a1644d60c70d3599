"""Reference data, certificates, numbers of random examples, running processes, and one without descriptors."""

from __future__ import annotations

import contextlib
import math
import os
import resource
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

from harness.server import REFERENCE
from harness.waiting import TIMEOUT_S

if TYPE_CHECKING:
    from hypothesis import settings


def shared_data() -> Path:
    """The folder of reference data; skips the test where it is absent."""
    if not REFERENCE.is_dir():
        pytest.skip("the reference data beside the checkout (../shared/data) is absent")
    return REFERENCE


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


def runs(pid: int) -> bool:
    """Return True for a process that has not ended; a zombie has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def is_open(port: int) -> bool:
    """Return True if somebody listens on a port of this machine."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def openssl(*arguments: str) -> None:
    """Call openssl."""
    subprocess.run(["openssl", *arguments], check=True, capture_output=True, timeout=TIMEOUT_S)


# The profile `explore` draws this many examples of a test that names no number.
EXAMPLES_OF_EXPLORING = 100


def examples(count: int) -> settings:
    """Settings of a test that draws ``count`` examples in the profile ``explore``, and its share in another."""
    from hypothesis import settings

    return settings(max_examples=in_proportion(count))


def in_proportion(count: int) -> int:
    """Return ``count`` in the profile ``explore``, and its share in another, for tests that draw by themselves."""
    from hypothesis import settings

    assert settings.default is not None
    return math.ceil(count * settings.default.max_examples / EXAMPLES_OF_EXPLORING)


# Beside those that are open; so few that to use them up takes no time.
DESCRIPTORS_LEFT = 64


@contextlib.contextmanager
def no_descriptors_left() -> Iterator[None]:
    """Have this process use up its file descriptors, as clients do that connect without end."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    greatest = max(int(each.name) for each in Path("/proc/self/fd").iterdir())
    resource.setrlimit(resource.RLIMIT_NOFILE, (greatest + DESCRIPTORS_LEFT, hard))
    used: list[int] = []
    try:
        with contextlib.suppress(OSError):
            while True:
                used.append(os.open(os.devnull, os.O_RDONLY))
        yield
    finally:
        for descriptor in used:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
