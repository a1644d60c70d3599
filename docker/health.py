"""Tells whether the server lives: exit code 0 if it does. With ``readyz``: whether it would move the arm.

The engine asks the former: an arm with a fault waits for somebody, and to start the container anew would not help it.
"""

from __future__ import annotations

import http.client
import os
import ssl
import sys
import urllib.error
import urllib.request

TIMEOUT_S = 2.0


def main(arguments: list[str]) -> int:
    """Ask, by HTTPS where the server does not speak HTTP."""
    path = arguments[0] if arguments else "livez"
    address = f"127.0.0.1:{os.environ.get('ARMBRIDGE_SERVER__PORT', '9090')}/{path}"
    for scheme in ("http", "https"):
        try:
            # It is this container's own server: there is nobody to tell it from by a certificate.
            unchecked = ssl._create_unverified_context()  # noqa: S323, SLF001
            with urllib.request.urlopen(f"{scheme}://{address}", timeout=TIMEOUT_S, context=unchecked) as answer:  # noqa: S310
                sys.stdout.write(answer.read(4096).decode())
                return 0
        except urllib.error.HTTPError as error:
            sys.stdout.write(error.read(4096).decode())
            return 1
        except (OSError, http.client.HTTPException) as error:
            failure = error
    sys.stdout.write(f"no answer at {address}: {failure}\n")
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
