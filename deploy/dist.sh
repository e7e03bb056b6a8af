#!/usr/bin/env bash
# Builds what is given away, for x86-64 or aarch64: the whole program, the node for a board, Debian packages, licences, a
# bill of materials (CycloneDX), checksums. Called by `make dist`; TARGET names another target than this machine's.
#
# The programs run on systems whose glibc is not older than the one they were built against: Debian 12 has 2.36 (Debian 12
# and 13, Ubuntu 24.04, JetPack 7), Ubuntu 22.04 2.35 (and JetPack 6), Debian 11 and Ubuntu 20.04 2.31 (and JetPack 5).
# So build on the oldest system that is to be served; the oldest glibc needed is printed and checked.
set -euo pipefail
cd "$(dirname "$0")/.."

host=$(rustc -vV | awk '/^host:/ { print $2 }')
target=${TARGET:-$host}
out=target/dist
packages=${PACKAGES:-yes}
version=$(awk -F'"' '/^\[workspace.package\]/ { found = 1 } found && /^version/ { print $2; exit }' Cargo.toml)
options=(--locked --release --features turbojpeg)
built=target/release

case $target in
x86_64-unknown-linux-gnu) architecture=amd64 machine=x86_64 ;;
aarch64-unknown-linux-gnu) architecture=arm64 machine=aarch64 ;;
*)
    echo "nothing is given away for $target" >&2
    exit 1
    ;;
esac
[ -n "$(ls "$(rustc --print target-libdir --target "$target")"/libstd-*.rlib 2>/dev/null)" ] || {
    echo "Rust's standard library for $target is not there: rustup target add $target" >&2
    exit 1
}
strip="strip"
run=() deb=()
if [ "$target" != "$host" ]; then
    options+=(--target "$target")
    built=target/$target/release deb=(--target "$target")
    # Debian's cross toolchain: gcc-aarch64-linux-gnu g++-aarch64-linux-gnu; qemu-user runs what it makes.
    export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
    export CC_aarch64_unknown_linux_gnu=aarch64-linux-gnu-gcc CXX_aarch64_unknown_linux_gnu=aarch64-linux-gnu-g++
    strip=aarch64-linux-gnu-strip
    run=(qemu-aarch64 -L /usr/aarch64-linux-gnu)
fi
[ -e web/dist/hub.html ] || {
    echo "the pages are not built: make web" >&2
    exit 1
}

mkdir -p "$out"
cargo build "${options[@]}" --no-default-features
cp "$built/albireo" "$out/albireo-node-$version-$machine"
cargo build "${options[@]}"
cp "$built/albireo" "$out/albireo-$version-$machine"
"$strip" "$out/albireo-node-$version-$machine" "$out/albireo-$version-$machine"

# What is made once and is the same for every machine.
"${run[@]}" "$out/albireo-$version-$machine" man "$out/man"
mkdir -p "$out/completions"
for shell in bash zsh fish; do
    "${run[@]}" "$out/albireo-$version-$machine" completions "$shell" >"$out/completions/albireo.$shell"
done
python3 deploy/licences.py >"$out/licences.txt"
if cargo cyclonedx --version >/dev/null 2>&1; then
    cargo cyclonedx --format json --features turbojpeg --override-filename "albireo-$version.cdx"
    mv "albireo-$version.cdx.json" "$out/"
    git ls-files --others --exclude-standard '*.cdx.json' | xargs --no-run-if-empty rm -f
else
    echo "no cargo-cyclonedx: the bill of materials is left out (cargo install cargo-cyclonedx)" >&2
fi

# The library of the target's architecture, for the node's package.
ONNXRUNTIME_MACHINE=$machine bash deploy/fetch-onnxruntime.sh "$out/onnxruntime-$machine"
rm -rf "$out/onnxruntime"
cp -r "$out/onnxruntime-$machine" "$out/onnxruntime"

if [ "$packages" = yes ]; then
    if cargo deb --version >/dev/null 2>&1; then
        for variant in program node hub router; do
            case $variant in
            node) program=$out/albireo-node-$version-$machine ;;
            *) program=$out/albireo-$version-$machine ;;
            esac
            cp "$program" "$built/albireo"
            cargo deb --no-build --no-strip "${deb[@]}" --variant "$variant" --output "$out/"
        done
    else
        echo "no cargo-deb: packages are left out (cargo install cargo-deb)" >&2
    fi
fi

needed=$(objdump -T "$out"/albireo-*"$version-$machine" | grep -o 'GLIBC_[0-9.]*' | sort -V | uniq | tail -n 1)
echo "the programs for $machine ($architecture) need $needed or newer"
(cd "$out" && find . -maxdepth 1 -type f ! -name SHA256SUMS -print0 | sort -z | xargs -0 sha256sum >SHA256SUMS)
echo "in $out:"
cat "$out/SHA256SUMS"
