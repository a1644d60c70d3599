"""Hooks of the site's build (mkdocs.yml): a page of it stands alone, and runs no script but a file."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

_OUTSIDE = re.compile(r"\[([^\]]+)\]\(\.\./([^)#]+)[^)]*\)")
_INLINE_SCRIPT = re.compile(r"<script>(.+?)</script>", re.DOTALL)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Name the files of the repository that a page links to: the site has only the pages."""
    return _OUTSIDE.sub(lambda link: f"{link[1]} (`{link[2]}` in the source)", markdown)


def on_post_page(output: str, config: Any, **_: Any) -> str:
    """Move a page's scripts into files: POLICY in server/gateway/http.py allows no others."""

    def in_file(script: re.Match[str]) -> str:
        name = f"assets/inline_{hashlib.sha256(script[1].encode()).hexdigest()[:12]}.js"
        file = Path(config["site_dir"]) / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(script[1])
        return f'<script src="{name}"></script>'

    return _INLINE_SCRIPT.sub(in_file, output)
