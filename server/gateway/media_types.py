"""What a file is, by the end of its name; the machine's own table is not asked, for some get ``.js`` wrong."""

from __future__ import annotations

from pathlib import PurePath

UNKNOWN = "application/octet-stream"

_TEXTS = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".mjs": "text/javascript",
    # Browsers show plain text and would save what they are told is Markdown.
    ".md": "text/plain",
    ".txt": "text/plain",
    ".json": "application/json",
    ".map": "application/json",
    ".webmanifest": "application/manifest+json",
    ".svg": "image/svg+xml",
    ".urdf": "application/xml",
    ".srdf": "application/xml",
    ".xml": "application/xml",
    ".dae": "model/vnd.collada+xml",
    ".gltf": "model/gltf+json",
    ".obj": "model/obj",
    ".mtl": "model/mtl",
}
_BINARIES = {
    ".ico": "image/x-icon",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".bmp": "image/bmp",
    ".tif": "image/tiff",
    ".woff2": "font/woff2",
    ".wasm": "application/wasm",
    ".stl": "model/stl",
    ".glb": "model/gltf-binary",
}

# What has little to gain by another compression.
_COMPRESSED = frozenset((".png", ".jpg", ".jpeg", ".woff2"))


def media_type(name: str) -> str:
    """The Content-Type of a file."""
    suffix = PurePath(name).suffix.lower()
    text = _TEXTS.get(suffix)
    return f"{text}; charset=utf-8" if text else _BINARIES.get(suffix, UNKNOWN)


def compressible(name: str) -> bool:
    """Whether gzip makes a file smaller: texts, and coordinates by the thousand."""
    return PurePath(name).suffix.lower() not in _COMPRESSED
