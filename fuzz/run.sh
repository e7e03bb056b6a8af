#!/usr/bin/env bash
# Runs every fuzzer side by side, MINUTES each (20), as many at a time as there are processors. An input that fails is kept in
# fuzz/artifacts; put it into fuzz/corpus with what it found mended, and `make test` runs it from then on.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo +nightly --version >/dev/null 2>&1 || {
    echo "nightly Rust is missing: rustup toolchain install nightly --profile minimal" >&2
    exit 1
}
cargo fuzz --version >/dev/null 2>&1 || {
    echo "cargo-fuzz is missing: cargo install --locked cargo-fuzz" >&2
    exit 1
}
minutes=${MINUTES:-20}
out=target/fuzz
mkdir -p "$out"
export CARGO_TARGET_DIR=$PWD/target/fuzz/build
# No pages to embed, and no link-time optimisation: it would take longer than the fuzzing.
export ALBIREO_WITHOUT_PAGES=1 CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_OPT_LEVEL=1
options=(--fuzz-dir fuzz --features libfuzzer --sanitizer "${SANITIZER:-none}" -O -a)
cargo +nightly fuzz build "${options[@]}"
# What fuzzing adds to a corpus stays out of the repository: only failures are kept by hand.
fuzz() {
    mkdir -p "$out/corpus/$1" "fuzz/artifacts/$1"
    cargo +nightly fuzz run "${options[@]}" "$1" "$out/corpus/$1" "fuzz/corpus/$1" -- -max_total_time=$((minutes * 60)) \
        -rss_limit_mb=2048 -timeout=10 -max_len=65536 -print_final_stats=1 >"$out/$1.log" 2>&1 || {
        echo "$1 FAILED: see $out/$1.log and fuzz/artifacts/$1"
        return 1
    }
    printf '%-16s %s runs, %s inputs found\n' "$1" "$(awk '/stat::number_of_executed_units/ { print $2 }' "$out/$1.log")" \
        "$(awk '/stat::new_units_added/ { print $2 }' "$out/$1.log")"
}
status=0
for fuzzer in fuzz/fuzz_targets/*.rs; do
    while [ "$(jobs -rp | wc -l)" -ge "$(nproc)" ]; do wait -n || status=1; done
    fuzz "$(basename "$fuzzer" .rs)" &
done
while [ -n "$(jobs -rp)" ]; do wait -n || status=1; done
exit "$status"
