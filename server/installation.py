"""Version of the installed program, and of the page that is built into it."""

import re
from importlib import metadata
from pathlib import Path

import server

# Built by `make page` from the sources beside it; in a wheel it is there without them.
PAGE_DIRECTORY = Path(server.__file__).parent / "page" / "dist"

# Built by `make docs`; a wheel has it where it was built.
DOCS_DIRECTORY = Path(server.__file__).parent / "docs_site"

_PAGE_VERSION = re.compile(r'<meta name="version" content="([^"]+)">')


def version_line(page_directory: Path = PAGE_DIRECTORY) -> str:
    program = f"armbridge {metadata.version('armbridge')}"
    try:
        index = (page_directory / "index.html").read_text(encoding="utf-8")
    except FileNotFoundError:
        return f"{program}, without the page"
    found = _PAGE_VERSION.search(index)
    return f"{program}, page {found[1] if found else 'of an unknown version'}"
