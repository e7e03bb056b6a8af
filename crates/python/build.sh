#!/usr/bin/env bash
# Builds the wheel of the Python package and its source distribution into target/wheels; with a machine ("x86_64",
# "aarch64") that machine's wheel for every Linux since 2014, into a folder of its own, linked by Zig.
set -euo pipefail
cd "$(dirname "$0")/../.."
machine=${1:-}
[ -x .cache/maturin/bin/maturin ] || {
    python3 -m venv .cache/maturin
    .cache/maturin/bin/python -m pip install --quiet --no-compile --disable-pip-version-check maturin==1.16.0
}
export PATH="$PWD/.cache/maturin/bin:$PATH" CARGO_TARGET_DIR="$PWD/target/python"
options=(--release --locked --manifest-path crates/python/Cargo.toml)
[ -n "$machine" ] || rm -f target/wheels/albireo-*
maturin sdist --manifest-path crates/python/Cargo.toml --out target/wheels
if [ -z "$machine" ]; then
    maturin build "${options[@]}" --out target/wheels
else
    target=$machine-unknown-linux-gnu
    python -m pip install --quiet --disable-pip-version-check ziglang==0.17.1
    rustup target add "$target"
    maturin build "${options[@]}" --zig --target "$target" --compatibility manylinux2014 --out "target/wheels/$machine"
fi
