#!/usr/bin/env bash
# Builds the program with the options that all development commands share, and says how far it is.
set -euo pipefail
cd "$(dirname "$0")/.."
read -ra options <<< "--locked $(bash tests/features.sh)"

if [ ! -x target/debug/albireo ]; then
    crates=$(cargo tree --locked --workspace --prefix none --format '{p}' -e normal,build 2> /dev/null | sed -E 's/ \((\*|proc-macro)\)//g' | sort -u | wc -l)
    echo "The first build compiles $crates crates: 8 minutes on two idle cores, 25 on busy ones."
fi
if [ -t 2 ]; then
    # cargo's own bar shows how far it is.
    cargo build "${options[@]}" --bin albireo
else
    cargo build "${options[@]}" --bin albireo 2>&1 | awk -v every=50 '
        /^ *(Compiling|Downloaded) / { if ($1 == "Compiling" && ++crates % every == 0) { print crates " crates begun"; fflush() } next }
        { print; fflush() }'
fi
bash tests/needs.sh
