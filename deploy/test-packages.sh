#!/usr/bin/env bash
# Installs the packages of `make dist` in a fresh Debian, booted with its own systemd, and repeats an operator's steps:
# install, query, change, upgrade, remove, purge; for node, hub and router.
#
#   sudo deploy/test-packages.sh          # needs debootstrap, systemd-container, curl; some 400 MB in the temporary folder
#
# shellcheck disable=SC2016 # text in single quotes is for the shell inside
# SUITE: another Debian than bookworm. BASE: a folder that keeps the bare system for the next time.
set -euo pipefail
cd "$(dirname "$0")/.."
[ "$(id -u)" = 0 ] || {
    echo "must run as root: a system is made and booted" >&2
    exit 1
}
dist=target/dist
architecture=$(dpkg --print-architecture)
work=$(mktemp -d)
base=${BASE:-$work/base}
root=$work/root

step() { printf '\n%s\n' "$*"; }
fail() {
    echo "failed: $*" >&2
    inside journalctl --no-pager --lines 40 >&2 || true
    exit 1
}
check() {
    local what=$1
    shift
    "$@" || fail "$what"
    echo "  $what"
}
container=
end() {
    [ -z "$container" ] || kill "$container" 2>/dev/null || true
    wait 2>/dev/null || true
    rm -rf "$work"
}
trap end EXIT

packages=()
for name in albireo-node albireo albireo-hub albireo-router; do
    found=("$dist/${name}_"*"_$architecture.deb")
    [ -e "${found[0]}" ] || {
        echo "$dist has no package $name for $architecture: make dist, with cargo-deb installed" >&2
        exit 1
    }
    packages+=("${found[0]}")
done

if [ ! -e "$base/bin/systemctl" ]; then
    step "a bare ${SUITE:-bookworm}, as boards and servers have it"
    debootstrap --variant=minbase --include=systemd,systemd-sysv,dbus,curl,passwd,adduser,libstdc++6,libgcc-s1,udev \
        "${SUITE:-bookworm}" "$base" >"$work/debootstrap.log" || {
        tail -n 20 "$work/debootstrap.log" >&2
        exit 1
    }
fi
cp -a "$base" "$root"
mkdir "$root/packages" "$root/upgrades"
cp "${packages[@]}" "$root/packages/"
# The next version: the same files under a higher number.
for package in "${packages[@]}"; do
    dpkg-deb --raw-extract "$package" "$work/unpacked"
    sed -i 's/^Version: .*/&+next/' "$work/unpacked/DEBIAN/control"
    dpkg-deb -Zgzip -z1 --build --root-owner-group "$work/unpacked" "$root/upgrades/" >/dev/null
    rm -rf "$work/unpacked"
done
echo board-7 >"$root/etc/hostname"

# A separate network with only loopback, so that its ports are not this machine's.
systemd-nspawn --quiet --boot --register=no --keep-unit --private-network --link-journal=no --directory "$root" \
    >"$work/console" 2>&1 </dev/null &
container=$!
leader=
for _ in $(seq 300); do
    leader=$(pgrep -P "$container" || true)
    if [ -n "$leader" ] && nsenter --target "$leader" --all systemctl is-system-running 2>/dev/null | grep -qE 'running|degraded'; then
        break
    fi
    kill -0 "$container" 2>/dev/null || {
        cat "$work/console" >&2
        exit 1
    }
    sleep 0.2
done
inside() { nsenter --target "$leader" --mount --uts --ipc --net --pid --cgroup -- "$@"; }
inside systemctl is-system-running || true

# Until a condition holds; a service under systemd says itself when it is ready.
holds() {
    for _ in $(seq 150); do
        if "$@" >/dev/null 2>&1; then return 0; fi
        sleep 0.2
    done
    return 1
}
install() { inside env DEBIAN_FRONTEND=noninteractive dpkg --force-confold --install "$@" >>"$work/dpkg.log" 2>&1 || {
    tail -n 30 "$work/dpkg.log" >&2
    fail "dpkg --install $*"
}; }
purge() { inside dpkg --purge "$@" >>"$work/dpkg.log" 2>&1 || fail "dpkg --purge $*"; }
pid_of() { inside systemctl show --property MainPID --value "$1"; }
get() { inside curl --silent --show-error --fail "$@"; }

step "node: installed, it runs under the machine's name"
install "/packages/$(basename "${packages[0]}")"
check "the service is active, has notified systemd, and the watchdog is on" inside systemctl is-active --quiet albireo-node
check "it answers that it is ready" holds get http://127.0.0.1:8080/readyz
check "its name is the machine's" inside sh -c 'curl -s http://127.0.0.1:8080/readyz | grep -q board-7'
check "a token of its own was made, which only the service reads" inside sh -c \
    '[ "$(stat -c "%U:%G %a" /etc/albireo/node-token)" = "root:albireo 640" ] && [ "$(wc -c </etc/albireo/node-token)" -ge 32 ]'
check "the service is not root" inside sh -c '[ "$(stat -c %U /proc/'"$(pid_of albireo-node)"')" = albireo ]'
check "the configuration can be used, and the model runs" inside env "$(inside cat /etc/default/albireo-node)" \
    albireo check --online /etc/albireo/node.toml
check "the manual is there" inside test -s /usr/share/man/man1/albireo-node.1.gz
step "node: changed, then upgraded"
token=$(inside cat /etc/albireo/node-token)
check "a stranger reads nothing but health" inside sh -c '! curl -sf http://127.0.0.1:8080/api/v1/node'
check "a stranger cannot set the threshold" inside sh -c \
    '! curl -sf -X PUT http://127.0.0.1:8080/api/v1/threshold -H "content-type: application/json" -d "{\"u\": 6e-4}"'
check "the token's owner can" get -X PUT http://127.0.0.1:8080/api/v1/threshold -H "authorization: Bearer $token" \
    -H 'content-type: application/json' -d '{"u": 6e-4}' --output /dev/null
inside sh -c 'echo "# a line of the operator" >>/etc/albireo/node.toml'
before=$(pid_of albireo-node)
install "/upgrades/$(basename "${packages[0]%_*}" | sed 's/$/+next/')_$architecture.deb"
check "it was restarted" sh -c "[ '$before' != '$(pid_of albireo-node)' ] && [ '$(pid_of albireo-node)' != 0 ]"
check "it answers that it is ready" holds get http://127.0.0.1:8080/readyz
check "the operator's configuration is kept" inside grep -q 'a line of the operator' /etc/albireo/node.toml
check "the token is kept" sh -c "[ '$token' = '$(inside cat /etc/albireo/node-token)' ]"
check "the threshold that was set is still in force" inside sh -c \
    'curl -s http://127.0.0.1:8080/api/v1/threshold -H "authorization: Bearer $(cat /etc/albireo/node-token)" | grep -q 0.0006'
step "node: killed, removed, purged"
before=$(pid_of albireo-node)
inside sh -c "kill -KILL $before"
again() { [ "$(pid_of albireo-node)" != "$before" ] && get http://127.0.0.1:8080/readyz; }
check "killed, it comes back by itself" holds again
inside dpkg --remove albireo-node >>"$work/dpkg.log" 2>&1
check "removed, nothing runs and the configuration stays" inside sh -c \
    '! systemctl is-active --quiet albireo-node && [ -e /etc/albireo/node.toml ]'
purge albireo-node
check "purged, nothing of it is left" inside sh -c '[ ! -e /etc/albireo ] && [ ! -e /var/lib/albireo ]'

step "hub: installed, it answers and keeps its database"
install "/packages/$(basename "${packages[1]}")" "/packages/$(basename "${packages[2]}")"
check "the service is active" inside systemctl is-active --quiet albireo-hub
check "it answers that it is ready" holds get http://127.0.0.1:8090/readyz
install "/upgrades/$(basename "${packages[1]%_*}" | sed 's/$/+next/')_$architecture.deb" \
    "/upgrades/$(basename "${packages[2]%_*}" | sed 's/$/+next/')_$architecture.deb"
check "upgraded, it answers again" holds get http://127.0.0.1:8090/readyz
check "its database is where state belongs" inside sh -c 'ls /var/lib/albireo-hub/*.db /var/lib/private/albireo-hub/*.db 2>/dev/null | grep -q .'

step "router: installed, it waits for its certificates, then runs with mutual TLS"
install "/packages/$(basename "${packages[3]}")"
check "it is not started without certificates" inside sh -c '! systemctl is-active --quiet albireo-router'
inside sh -c 'cd /root && albireo cert authority --name test && albireo cert router router-1 --host localhost && albireo acl --output /etc/albireo/access.json &&
    cp authority/authority.pem /etc/albireo/ && cp authority/router/router-1.pem /etc/albireo/router.pem &&
    install -m 0640 -g albireo-router authority/router/router-1.key /etc/albireo/router.key' >>"$work/dpkg.log" 2>&1 ||
    fail "the certificates"
check "it starts" inside systemctl enable --now albireo-router
check "it answers that it is ready" holds get http://127.0.0.1:8095/readyz
purge albireo-router albireo-hub albireo
check "purged, nothing of hub and router is left" inside sh -c '[ ! -e /etc/albireo/hub.toml ] && [ ! -e /var/lib/albireo-hub ]'
step "all of it works"
