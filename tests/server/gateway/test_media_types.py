from __future__ import annotations

import pytest

from server.gateway.media_types import compressible, media_type


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("index.html", "text/html; charset=utf-8"),
        ("a/b.MJS", "text/javascript; charset=utf-8"),
        ("style.css", "text/css; charset=utf-8"),
        ("icon.svg", "image/svg+xml; charset=utf-8"),
        ("base.stl", "model/stl"),
        ("base.DAE", "model/vnd.collada+xml; charset=utf-8"),
        ("texture.png", "image/png"),
        ("file", "application/octet-stream"),
        (".html", "application/octet-stream"),
        ("x.exe", "application/octet-stream"),
    ],
)
def test_a_file_is_what_its_name_ends_in(name: str, kind: str) -> None:
    assert media_type(name) == kind


def test_what_is_compressed_already_is_not_compressed_again() -> None:
    assert compressible("vendor.js")
    assert compressible("base.STL")
    assert not compressible("texture.PNG")
