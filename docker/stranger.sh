#!/usr/bin/env bash
# Plays someone who has just found armbridge: a bare Debian without python3-venv and Node.js, then with what the
# messages ask for, up to a moved arm. Run it as root; needs mmdebstrap, 4 GB of disk and five minutes.
#
#   docker/stranger.sh bookworm    Debian 12, whose Node.js 18 is too old for the page
#   docker/stranger.sh trixie      Debian 13, whose Node.js builds the page
#
# Environment: DEBIAN_MIRROR. What is committed is tried, not what lies in the folder. pip, npm and certificates are
# configured as on this machine.
set -euo pipefail
cd "$(dirname "$0")/.."

readonly SUITE="${1:-trixie}" MIRROR="${DEBIAN_MIRROR:-http://deb.debian.org/debian}" START_S=420
readonly WORK="$PWD/build/stranger" ROOT="$PWD/build/stranger/$SUITE"

say() { printf '== %s\n' "$*"; }

fail() {
    printf 'stranger.sh: %s\n' "$*" >&2
    [ ! -s "$WORK/last.log" ] || tail -n 30 "$WORK/last.log" >&2
    exit 1
}

# A command as the stranger types it; its output is in last.log.
stranger() {
    # shellcheck disable=SC2016  # the inner shell expands them
    unshare --mount --pid --fork --kill-child bash -c \
        'mount -t proc proc "$0/proc" && mount --rbind /dev "$0/dev" &&
         for path in $2; do mount --rbind "$path" "$0/$path" || exit; done &&
         exec chroot "$0" /bin/bash -c "cd /root/armbridge || exit; $1"' "$ROOT" "$1" "$(local_indexes)" >"$WORK/last.log" 2>&1
}

# Directories that pip's configuration names, with the files beside an index.
local_indexes() {
    python3 -m pip config list | grep -E 'index-url|find-links' | grep -oE "/[^/ '\"][^ '\"]*" | sed 's#/simple/*$##' |
        sort -u | while read -r path; do [ ! -d "$path" ] || echo "$path"; done
}

is_said() { grep -q -- "$1" "$WORK/last.log" || fail "nothing says: $1"; }

make_root() {
    say "a bare $SUITE"
    rm -rf "$ROOT"
    mkdir -p "$WORK"
    mmdebstrap --quiet --variant=minbase --include=python3,make,git,ca-certificates "$SUITE" "$ROOT" "$MIRROR"
    local path
    for path in /etc/resolv.conf /etc/ssl/certs/ca-certificates.crt /etc/pip.conf /etc/xdg/pip "$HOME/.config/pip" \
        "$HOME/.npmrc"; do
        [ -e "$path" ] || continue
        mkdir -p "$ROOT/$(dirname "$path")"
        cp -aLT "$path" "$ROOT/$path"
    done
    for path in $(local_indexes); do mkdir -p "$ROOT/$path"; done
    git clone --quiet --no-hardlinks . "$ROOT/root/armbridge"
}

without_venv() {
    say "make run without python3-venv: one line says what to install, and nothing is left half made"
    ! stranger "make run" || fail "make run succeeded without python3-venv"
    is_said "apt-get install python3-venv"
    [ ! -e "$ROOT/root/armbridge/.venv" ] || fail "there is a .venv that cannot be used"
    stranger "apt-get update -q && apt-get install -y -q --no-install-recommends python3-venv" || fail "no python3-venv"
}

# The server runs while the program of the README moves the arm.
moves() {
    cp "$WORK/readme.py" "$ROOT/root/readme.py"
    stranger "make run >/root/server.log 2>&1 & server=\$!
        for _ in \$(seq $START_S); do grep -q 'ws://127.0.0.1:9090' /root/server.log && break; kill -0 \$server || break; sleep 1; done
        timeout 60 .venv/bin/python /root/readme.py; code=\$?
        .venv/bin/python -c 'import urllib.request as r; print(\"page:\", b\"<canvas\" in r.urlopen(\"http://127.0.0.1:9090/\").read())'
        kill -INT \$(cat /proc/[0-9]*/stat | sed -n 's/^\([0-9]*\) (armbridge).*/\1/p' | head -1) \$server; cat /root/server.log; exit \$code" || fail "the arm was not moved"
}

make_root
.venv/bin/python -c '
import re, pathlib
print(re.search(r"```python\n(.*?)```", pathlib.Path("README.md").read_text(), re.DOTALL)[1])' >"$WORK/readme.py"
without_venv
say "make run without Node.js, and the program of the README"
moves
say "make run with Debian's Node.js"
stranger "apt-get install -y -q --no-install-recommends nodejs npm" || fail "no Node.js"
moves
if [ "$SUITE" = bookworm ]; then
    is_said "cannot build the page, which needs Node.js"
    [ "$(grep -ci 'node\|npm' "$WORK/last.log")" -le 2 ] || fail "more than a line about Node.js"
else
    is_said "page: True"
fi
rm -rf "$ROOT"
say "all of it works on $SUITE"
