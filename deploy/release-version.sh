#!/usr/bin/env bash
# Checks that a tag (v0.2.0) is the version of the workspace, of the Python package and of the top of CHANGELOG.md, and prints
# what that version changes. Without a tag it checks that the three agree.
set -euo pipefail
cd "$(dirname "$0")/.."
version_in() { awk -F'"' -v section="$2" '$0 == section { found = 1 } found && /^version = / { print $2; exit }' "$1"; }
version=$(version_in Cargo.toml '[workspace.package]')
python=$(version_in crates/python/Cargo.toml '[package]')
newest=$(awk '/^## / { print $2; exit }' CHANGELOG.md)
tag=${1:-v$version}
for other in "the tag ${tag#v}" "crates/python/Cargo.toml $python" "CHANGELOG.md $newest"; do
    [ "${other##* }" = "$version" ] || {
        echo "Cargo.toml has version $version, but ${other% *} has ${other##* }" >&2
        exit 1
    }
done
awk '/^## / { if (found) exit; found = 1; next } found' CHANGELOG.md
