#!/usr/bin/env bash
# Says what building the program still needs on this machine, one line each, with the way out. What it cannot be built
# without ends with an error before anything is compiled. The build runs it again at its end: its lines are then in sight.
set -uo pipefail
cd "$(dirname "$0")/.." || exit 1

failed=0
fatal() { echo "missing: $*" >&2; failed=1; }
without() { echo "missing: $*" >&2; }
# Whether a version is at least another one.
at_least() { [ "$(printf '%s\n%s\n' "$2" "$1" | sort -V | head -n 1)" = "$2" ]; }

wanted=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)
rust=$(rustc --version 2> /dev/null | awk '{ print $2 }')
if [ -z "$rust" ]; then
    fatal "Rust $wanted: install it from https://rustup.rs (a distribution's is usually older)"
elif ! at_least "$rust" "$wanted"; then
    fatal "Rust $wanted; this is $rust: \`rustup update\`, or install it from https://rustup.rs"
fi
command -v cc > /dev/null || fatal "a C compiler (apt-get install gcc libc6-dev)"
if ! command -v python3 > /dev/null; then
    fatal "Python 3 with pip, which fetches ONNX Runtime (apt-get install python3 python3-pip)"
elif ! python3 -m pip --version > /dev/null 2>&1; then
    fatal "pip, which fetches ONNX Runtime (apt-get install python3-pip)"
fi
node=$(node --version 2> /dev/null | tr -d v)
if [ -z "$node" ] || ! command -v npm > /dev/null; then
    without "Node.js 20.19 with npm: there will be no pages, only the API (https://nodejs.org; Debian 12's is too old)"
elif ! at_least "$node" 20.19; then
    without "Node.js 20.19; this is $node: there will be no pages, only the API (https://nodejs.org; Debian 12's is too old)"
fi
command -v ffmpeg > /dev/null || without "ffmpeg: no camera and no video file can be opened (apt-get install ffmpeg)"
free=$(df -Pk . | awk 'NR == 2 { print int($4 / 1048576) }')
[ -d target ] || [ "$free" -ge 6 ] || fatal "disk: 6 GB are needed here, $free GB are free"

if [ "$failed" -ne 0 ]; then
    echo "Nothing was built. Without a compiler: \`cd deploy/docker && docker compose up --build\`" >&2
    exit 1
fi
