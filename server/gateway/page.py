"""Where the built page is, and what is said while there is none."""

from __future__ import annotations

from pathlib import Path

import server
from server.errors import FileTooLargeError, ServiceError

# Built by `make page` from the sources beside it; in a wheel it is there without them.
PAGE_DIRECTORY = Path(server.__file__).parent / "page" / "dist"

INDEX = "index.html"

# The page's largest file, its libraries, has one.
MAX_FILE_BYTES = 8 << 20

HOW_TO_GET_IT = "the page is not built: install Node.js 20.19 or later with npm, and call make page"

NOT_BUILT = f"""<!doctype html>
<html lang="en">
<head><meta charset="utf-8"><title>armbridge</title></head>
<body>
<h1>armbridge is running</h1>
<p>Clients of rosbridge connect to this address.</p>
<p>What is missing is the page for people. Here {HOW_TO_GET_IT}. Then load this address again.</p>
</body>
</html>
"""


def is_built(directory: Path) -> bool:
    """Whether there is a page."""
    return (directory / INDEX).is_file()


def find_page_file(directory: Path, name: str) -> Path:
    """Where a file of the page is.

    Args:
        directory: the built page.
        name: path below it; empty for the page itself.

    Raises:
        ServiceError: there is none, or it is outside the directory.
        FileTooLargeError: it is too large to be one.
    """
    nowhere = f"{('/' + name)!r} is no file of the page"
    try:
        root = directory.resolve()
        path = (root / (name or INDEX)).resolve()
        if not path.is_relative_to(root) or not path.is_file():
            raise ServiceError(nowhere)
        size_bytes = path.stat().st_size
    # A name with a zero byte is no name of a file.
    except (OSError, ValueError) as error:
        raise ServiceError(f"{nowhere}: {error}") from error
    if size_bytes > MAX_FILE_BYTES:
        raise FileTooLargeError(f"{('/' + name)!r} has {size_bytes} bytes, the limit is {MAX_FILE_BYTES}")
    return path
