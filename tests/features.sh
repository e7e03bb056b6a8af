#!/usr/bin/env bash
# Prints the cargo options for the optional features that can be built here, and on the error output what is missing.
needed=(cmake)
[ "$(uname -m)" = x86_64 ] && needed+=(nasm)
missing=()
for command in "${needed[@]}"; do
    command -v "$command" > /dev/null || missing+=("$command")
done
if [ ${#missing[@]} -eq 0 ]; then
    echo "--features turbojpeg"
else
    echo "no ${missing[*]}: the feature turbojpeg is left out" >&2
fi
