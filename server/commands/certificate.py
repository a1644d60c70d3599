"""Command ``armbridge certificate``: a certificate for this host that a phone accepts."""

from __future__ import annotations

import argparse
import os
import secrets
from pathlib import Path
from typing import TYPE_CHECKING

from robot.files import locked, replace
from server.commands.options import Subparsers, add_command
from server.commands.terminal import ExitCode, Terminal
from server.errors import ConfigurationError

if TYPE_CHECKING:
    from server.access.certificates import CertificateFiles, IssuedCertificate

_PHONES = """\
Bring {authority} onto each phone, once.
iPhone, iPad:
  1. Send the file by AirDrop or mail, and open it: "Profile Downloaded".
  2. Settings > General > VPN & Device Management > {common_name} > Install.
  3. Settings > General > About > Certificate Trust Settings: switch it on.
Android:
  1. Copy the file to the phone, by cable or mail.
  2. Settings > Security > Encryption & credentials > Install a certificate > CA certificate. The
     words differ from phone to phone: search the settings for "CA certificate".
  3. Choose the file. Chrome trusts it from then on.
Compare the fingerprint that the phone shows (SHA-256):
  {fingerprint}
Keep {authority_key} to yourself: anybody who has it can
pretend to be any website to these phones. Remove the authority from a phone that is no longer used."""


# The file of the setting access.token_file, and the name of the one whose token is made.
TOKEN_FILE, OWNER = "tokens.toml", "owner"
TABLES = "[admin_tokens], [operate_tokens], [propose_tokens], [view_tokens]"
FILE_HEADER = f"Tokens of clients, by name: {TABLES}; see docs/security.md."
TOKEN_BYTES = 16


def add_certificate_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "certificate",
        _certificate,
        "make a certificate for this machine that phones and browsers accept (https)",
        "Make a local certificate authority, once, and a certificate of it for the names and addresses of "
        "this machine, and say how the server and a phone take them. The first time, make a token as well. "
        "Called again it makes another certificate of the same authority. Nothing is sent anywhere.",
    )
    parser.add_argument(
        "--name",
        action="append",
        default=[],
        metavar="NAME_OR_ADDRESS",
        dest="names",
        help="one more host name or IP address by which phones reach the server; may be repeated",
    )
    parser.add_argument(
        "--directory", type=Path, metavar="FOLDER", help="where the files are kept (tls in the data folder)"
    )


def _certificate(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.access.certificates import CertificateFiles, issue_certificate
    from server.gateway.admission import host_addresses, own_names
    from server.moveit.named_states import data_directory

    directory = options.directory or data_directory(os.environ) / "tls"
    files = CertificateFiles(directory.absolute())
    own = ("localhost", *reversed(own_names()), *host_addresses(), "127.0.0.1", "::1")
    try:
        outcome = issue_certificate(files, (*options.names, *own))
        tokens, token = ensure_token(files.directory)
    except ConfigurationError as error:
        terminal.err(f"armbridge: {error}")
        return ExitCode.FAILED
    terminal.out(description_of(files, outcome, tokens, token))
    return ExitCode.DONE


def ensure_token(directory: Path) -> tuple[Path, str]:
    """Make a file of tokens with one in it, if there is none."""
    file, token = directory / TOKEN_FILE, secrets.token_hex(TOKEN_BYTES)
    try:
        with locked(file):
            if file.exists():
                return file, ""
            replace(file, f'# {FILE_HEADER}\n[admin_tokens]\n{OWNER} = "{token}"\n'.encode(), 0o600)
    except OSError as error:
        raise ConfigurationError(f"{file}: the token cannot be kept there: {error}") from error
    return file, token


def description_of(files: CertificateFiles, outcome: IssuedCertificate, tokens: Path, token: str) -> str:
    known = "" if outcome.made_authority else " Phones that trust it already need nothing."
    return "\n".join(
        (
            f"The certificate is valid until {outcome.ends:%Y-%m-%d}.",
            f"  certificate  {files.certificate}",
            f"  its key      {files.key}",
            f"  authority    {files.authority} ({'new' if outcome.made_authority else 'as before'}).{known}",
            f"  names        {', '.join(outcome.names)}",
            "",
            *_about_token(tokens, token),
            "",
            "Start the server with both, for other machines:",
            "  armbridge serve --host 0.0.0.0 \\",
            f"    --set access.token_file={tokens} \\",
            f"    --set server.tls_certificate={files.certificate} \\",
            f"    --set server.tls_key={files.key}",
            "A server that runs with one takes the new one on SIGHUP (systemctl reload armbridge).",
            "",
            _PHONES.format(
                authority=files.authority,
                authority_key=files.authority_key,
                common_name=outcome.authority_name,
                fingerprint=outcome.fingerprint,
            ),
        )
    )


def _about_token(file: Path, token: str) -> tuple[str, ...]:
    if not token:
        return (f"The tokens are in {file}, as before.",)
    return (
        "The token that pages and programs ask for, with all rights (shown only now):",
        f"  {token}",
        f"It is kept in {file}, which only you can read. Add tokens with fewer rights there.",
    )
