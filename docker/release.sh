#!/usr/bin/env bash
# Builds the release into build/release and tries it out: sdist and wheel, what an index would say about them, the wheel
# in an empty environment, and the image where an engine runs. Call it by `make release`, which builds the page and the site
# first.
set -euo pipefail
cd "$(dirname "$0")/.."

readonly OUT=build/release BIN="${BIN:-.venv/bin}"

say() { printf '== %s\n' "$*"; }

rm -rf "$OUT"
say "sdist and wheel"
"$BIN/uv" build --no-create-gitignore --out-dir "$OUT"
say "twine check"
"$BIN/twine" check --strict "$OUT"/*
say "the wheel in an empty environment"
WHEEL=$(echo "$OUT"/*.whl) "$BIN/python" -m pytest --quiet -n 0 tests/clients/test_wheel_smoke.py
if docker info >/dev/null 2>&1; then
    say "image"
    docker build --quiet --file docker/Dockerfile --tag "armbridge:$(sed -n 's/^version = "\(.*\)"$/\1/p' pyproject.toml)" .
else
    say "no image: docker does not run here; docker/verify.sh builds one without it"
fi
say "done: $(echo "$OUT"/*)"
