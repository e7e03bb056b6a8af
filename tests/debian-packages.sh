#!/usr/bin/env bash
# Installs missing Debian packages if this user is allowed to. Arguments: COMMAND:PACKAGE …, or :PACKAGE for a package without
# a command. Names a package that cannot be installed; the tests that need it are then skipped or fail.
set -u
missing=()
for pair in "$@"; do
    if [ -n "${pair%%:*}" ]; then
        command -v "${pair%%:*}" >/dev/null 2>&1 && continue
    else
        dpkg -s "${pair##*:}" 2>/dev/null | grep -q '^Status: .* installed$' && continue
    fi
    missing+=("${pair##*:}")
done
[ ${#missing[@]} -eq 0 ] && exit 0

as_root=()
if [ "$(id -u)" -ne 0 ]; then
    if sudo -n true 2>/dev/null; then as_root=(sudo -n); else
        echo "missing: ${missing[*]} (install with: sudo apt-get install ${missing[*]})" >&2
        exit 0
    fi
fi
if ! command -v apt-get >/dev/null 2>&1; then
    echo "missing: ${missing[*]} (no apt-get here; install them by your system's means)" >&2
    exit 0
fi
echo "installing ${missing[*]}"
export DEBIAN_FRONTEND=noninteractive
install() { "${as_root[@]}" apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null; }
install 2>/dev/null || { "${as_root[@]}" apt-get update -qq && install; } ||
    echo "could not install ${missing[*]}" >&2
exit 0
