#!/usr/bin/env bash
# Prints the cargo options that all development commands share, so that none recompiles a dependency that another one has
# compiled: the workspace, the optional features that can be built here, and those that the tests' dependencies add.
# Reports missing tools on standard error.
needed=(cmake)
[ "$(uname -m)" = x86_64 ] && needed+=(nasm)
missing=()
for command in "${needed[@]}"; do
    command -v "$command" > /dev/null || missing+=("$command")
done
if [ ${#missing[@]} -eq 0 ]; then
    echo "--workspace --features turbojpeg,development"
else
    echo "no ${missing[*]}: the feature turbojpeg is left out" >&2
    echo "--workspace --features development"
fi
