#!/usr/bin/env bash
# Builds the image and tries it, on a Debian machine that has neither an engine nor a registry of images: the base comes
# from Debian's packages. Run it as root. Needs 4 GB of disk, and some three minutes the first time.
#
#   docker/verify.sh           builds, tries, and leaves nothing behind
#   docker/verify.sh --keep    keeps base and layers in build/docker, so that the next run takes 40 s
#
# Environment: PYTHON, one that has websockets and mcap (.venv/bin/python); DEBIAN_MIRROR; MAX_IMAGE_MB (540).
set -euo pipefail
cd "$(dirname "$0")/.."

readonly BASE=docker.io/library/debian:trixie-slim IMAGE=localhost/armbridge:verify NAME="armbridge-verify-$$"
readonly WORK="$PWD/build/docker" PYTHON="${PYTHON:-.venv/bin/python}"
readonly MAX_MB="${MAX_IMAGE_MB:-540}" START_S=30 STOP_S=3
readonly KEEP="${1:-}"

say() { printf '== %s\n' "$*"; }

fail() {
    printf 'verify.sh: %s\n' "$*" >&2
    exit 1
}

check_tools() {
    local tool missing=()
    for tool in buildah podman runc mmdebstrap nsenter ip; do
        [ -n "$(PATH="$PATH:/usr/sbin:/sbin" type -P "$tool")" ] || missing+=("$tool")
    done
    [ ${#missing[@]} = 0 ] || fail "missing: ${missing[*]}; apt-get install --no-install-recommends" \
        "buildah podman runc mmdebstrap iproute2 util-linux"
    [ "$(id -u)" = 0 ] || fail "needs root, for mmdebstrap and for mounting layers"
    "$PYTHON" -c 'import mcap, websockets' || fail "$PYTHON lacks websockets or mcap: make install, or set PYTHON"
}

# Storage and state of its own: nothing of the machine's other containers is seen or touched.
prepare() {
    mkdir -p "$WORK"
    install --directory --owner 1000 --group 1000 "$WORK/home"
    cat >"$WORK/storage.conf" <<END
[storage]
driver = "overlay"
graphroot = "$WORK/store"
runroot = "$WORK/run"
END
    # Limits above the machine's own cannot be set from within another container.
    cat >"$WORK/containers.conf" <<END
[containers]
netns = "host"
default_ulimits = ["nofile=$(least 65536 "$(ulimit -Hn)")", "nproc=$(least 32768 "$(ulimit -Hu)")"]
[engine]
cgroup_manager = "cgroupfs"
events_logger = "file"
runtime = "runc"
END
    export CONTAINERS_STORAGE_CONF="$WORK/storage.conf" CONTAINERS_CONF="$WORK/containers.conf"
}

least() { if [ "$2" = unlimited ] || [ "$1" -lt "$2" ]; then echo "$1:$1"; else echo "$2:$2"; fi; }

make_base() {
    ! podman image exists "$BASE" || return 0
    say "base: Debian's packages, as $BASE"
    mmdebstrap --quiet --variant=minbase --dpkgopt='path-exclude=/usr/share/man/*' \
        --dpkgopt='path-exclude=/usr/share/locale/*' --dpkgopt='path-exclude=/usr/share/doc/*' \
        --dpkgopt='path-include=/usr/share/doc/*/copyright' trixie "$WORK/base.tar" ${DEBIAN_MIRROR:+"$DEBIAN_MIRROR"}
    podman import --quiet --change CMD=bash "$WORK/base.tar" "$BASE" >/dev/null
    rm "$WORK/base.tar"
}

# How this machine reaches packages, as volumes of the build, so that nothing of it is in the image: its authorities,
# pip's configuration, and the local directories that this names.
volumes() {
    local path
    for path in /usr/local/share/ca-certificates /etc/pip.conf "$HOME/.config/pip" $(local_indexes); do
        [ ! -e "$path" ] || printf -- '--volume\n%s:%s:ro\n' "$path" "${path/#$HOME//root}"
    done
}

local_indexes() {
    "$PYTHON" -m pip config list 2>/dev/null | grep -E 'index-url|find-links' | grep -oE "(file://)?/[^/ '\"][^ '\"]*" |
        sed -E 's#^file://##; s#/simple/?$##' | sort -u
}

build() {
    local options
    mapfile -t options < <(volumes)
    say "build"
    buildah bud --isolation oci --network host --pull-never --format docker --layers "${options[@]}" \
        --file docker/Dockerfile --tag "$IMAGE" . >"$WORK/build.log" 2>&1 ||
        { tail --lines 40 "$WORK/build.log" >&2; fail "the build failed; all it said: $WORK/build.log"; }
    grep -E '^ +[0-9.]+ MB  ' "$WORK/build.log" || true
}

check_image() {
    local size_mb
    size_mb=$(($(podman image inspect --format '{{.Size}}' "$IMAGE") / 1000000))
    say "image: $size_mb MB"
    [ "$size_mb" -lt "$MAX_MB" ] || fail "the image has $size_mb MB; $MAX_MB are allowed"
}

# A network that has nothing but a loopback: what is tried here is open to nobody else, and finds its port free.
within() { nsenter --net="/run/netns/$NAME" "$@"; }

# As docker/compose.yaml runs it.
run() {
    within podman run --name "$NAME" --health-interval disable --read-only --read-only-tmpfs=false --tmpfs /tmp \
        --cap-drop ALL --security-opt no-new-privileges --memory 3g --pids-limit 1024 \
        --volume "$WORK/home:/var/lib/armbridge" "$@" 2>&1 | grep -v 'unable to get systemd connection' || true
}

inside() { within podman exec "$NAME" "$@"; }

exit_code() { podman inspect --format '{{.State.ExitCode}}' "$NAME"; }

remove() { podman rm --force --time 1 "$NAME" >/dev/null 2>&1 || true; }

wait_until_ready() {
    local until_s=$((SECONDS + START_S))
    until inside python /opt/armbridge/health.py readyz >"$WORK/health" 2>&1; do
        [ $SECONDS -lt $until_s ] ||
            { podman logs "$NAME" >&2; fail "not ready within $START_S s: $(cat "$WORK/health")"; }
        sleep 0.2
    done
    within podman healthcheck run "$NAME" >/dev/null ||
        fail "the HEALTHCHECK says that a server that is ready is not healthy"
    say "healthy, and ready: $(cat "$WORK/health")"
}

check_user() {
    local user
    user="$(inside id --user):$(inside id --groups --name)"
    say "user: $user"
    [[ $user != 0:* && $user == *dialout* ]] || fail "must not be root, and in the group dialout: $user"
}

stop() {
    local started_ms stopped_ms
    started_ms=$(date +%s%3N)
    podman kill --signal TERM "$NAME" >/dev/null
    timeout "$STOP_S" podman wait "$NAME" >/dev/null 2>&1 || fail "SIGTERM did not stop it within $STOP_S s"
    stopped_ms=$(date +%s%3N)
    say "stopped by SIGTERM within $((stopped_ms - started_ms)) ms, exit code $(exit_code)"
    [ "$(exit_code)" = 0 ] || fail "the exit code must be 0"
}

try_default() {
    say "docker run armbridge"
    run --detach --env ARMBRIDGE_RECORDING__FILE=/var/lib/armbridge/run.mcap "$IMAGE" >/dev/null
    wait_until_ready
    check_user
    within "$PYTHON" docker/drive.py 9090
    podman top "$NAME" state | grep -q Z && fail "there are zombies: $(podman top "$NAME" pid state args)"
    stop
    "$PYTHON" docker/recorded.py "$WORK/home/run.mcap"
    remove
}

try_without_token() {
    say "docker run armbridge serve --host 0.0.0.0, without a token"
    local said
    said=$(run "$IMAGE" serve --host 0.0.0.0)
    printf '%s\n' "$said"
    [[ $(exit_code) != 0 && $said == *token* ]] || fail "it must not start, and name the token"
    remove
}

try_with_token() {
    say "docker run armbridge serve --host 0.0.0.0, with a token"
    local token
    token=$(head --bytes 16 /dev/urandom | od -An -tx1 | tr -d ' \n')
    run --detach --env ARMBRIDGE_ACCESS__TOKEN="$token" "$IMAGE" serve --host 0.0.0.0 >/dev/null
    wait_until_ready
    ! within "$PYTHON" docker/drive.py 9090 wrong >/dev/null 2>&1 || fail "a wrong token must not move the arm"
    within "$PYTHON" docker/drive.py 9090 "$token"
    ! podman logs "$NAME" 2>&1 | grep -q "$token" || fail "the log has the token in it"
    stop
    remove
}

clean() {
    remove
    ip netns delete "$NAME" 2>/dev/null || true
    rm -rf "${WORK:?}/home"
    [ "$KEEP" != --keep ] || return 0
    podman rmi --all --force >/dev/null 2>&1 || true
    umount "$WORK/store/overlay" 2>/dev/null || true
    rm -rf "$WORK"
}

check_tools
prepare
trap clean EXIT
ip netns add "$NAME"
within ip link set lo up
make_base
build
check_image
try_default
try_without_token
try_with_token
say "all is well"
