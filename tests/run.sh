#!/usr/bin/env bash
# Runs every test and closes with one line that counts them: "N passed, N failed, N skipped".
#
# Tests named shared_… read the recordings, clips and models of $ALBIREO_SHARED (default ../shared).
# Where that folder is missing they are not run and count as skipped.
set -uo pipefail
cd "$(dirname "$0")/.."

export ALBIREO_SHARED="${ALBIREO_SHARED:-$(cd .. && pwd)/shared}"
export ORT_DYLIB_PATH="${ORT_DYLIB_PATH:-$(ls "$PWD"/.cache/onnxruntime/libonnxruntime.so* 2>/dev/null | head -n 1)}"
export ALBIREO_PYTHON="${ALBIREO_PYTHON:-$PWD/.cache/python/bin/python}"

# With the feature turbojpeg where it can be built; its tests are named scaled_…
read -ra options <<< "--locked --workspace $(bash tests/features.sh)"
skipped=0
[ ${#options[@]} -eq 2 ] && skipped=$(grep -rhc 'fn scaled_' crates | awk '{ n += $1 } END { print n }')

cargo test "${options[@]}" --no-run || { echo "0 passed, 1 failed, 0 skipped"; exit 1; }

skip=()
if [ ! -d "$ALBIREO_SHARED" ]; then
    echo "no $ALBIREO_SHARED: the tests that read it are skipped"
    skip=(--skip shared_)
    skipped=$((skipped + $(cargo test "${options[@]}" --quiet -- --list 2>/dev/null | grep -c 'shared_.*: test$')))
fi

log=$(mktemp)
trap 'rm -f "$log"' EXIT
cargo test "${options[@]}" --no-fail-fast -- "${skip[@]}" 2>&1 | tee "$log"
status=$?

count() { awk -v what="$1" '/^test result:/ { for (i = 1; i < NF; i++) if ($(i + 1) ~ "^" what) n += $i } END { print n + 0 }' "$log"; }
passed=$(count passed)
failed=$(count failed)
skipped=$((skipped + $(count ignored)))
[ "$status" -ne 0 ] && [ "$failed" -eq 0 ] && failed=1
echo "$passed passed, $failed failed, $skipped skipped"
exit "$status"
