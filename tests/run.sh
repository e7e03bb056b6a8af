#!/usr/bin/env bash
# Runs every test that can run here and ends with one line that counts them: "N passed, N failed, N skipped".
#
# A test that needs more than the clone and Rust is marked #[ignore = "needs A and B"]. First all other tests run without
# any of these needs, as in a fresh clone. That run's output lists the marked tests and their needs; those whose needs are
# met run next, and the rest are skipped.
set -uo pipefail
cd "$(dirname "$0")/.."

export ALBIREO_SHARED="${ALBIREO_SHARED:-$(cd .. && pwd)/shared}"
export ORT_DYLIB_PATH="${ORT_DYLIB_PATH:-$(ls "$PWD"/.cache/onnxruntime/libonnxruntime.so* 2>/dev/null | head -n 1)}"
export ORT_DISABLE_TELEMETRY=1
export ALBIREO_PYTHON="${ALBIREO_PYTHON:-$PWD/.cache/python/bin/python}"
# Most tests spend most of their time waiting for processes.
export RUST_TEST_THREADS="${RUST_TEST_THREADS:-$((2 * $(nproc)))}"
# hadolint is installed in the same environment.
export PATH="$PATH:$(dirname "$ALBIREO_PYTHON")"

missing=()
need() { local what=$1; shift; "$@" > /dev/null 2>&1 || missing+=("$what"); }
need "../shared" test -d "$ALBIREO_SHARED"
need "ONNX Runtime" test -e "$ORT_DYLIB_PATH"
need "Python" "$ALBIREO_PYTHON" -c ""
need "the wheel" .cache/wheel/bin/python -c "import albireo, cv2, supervision"
need "ffmpeg" command -v ffmpeg
need "RTSP server" bash -c "command -v gst-launch-1.0 && gst-inspect-1.0 x264enc && gst-inspect-1.0 rtspsrc &&
    /usr/bin/python3 -c 'import gi; gi.require_version(\"GstRtspServer\", \"1.0\"); from gi.repository import GstRtspServer'"
need "Mosquitto" bash -c "command -v mosquitto && command -v mosquitto_sub && command -v mosquitto_passwd"
need "promtool" command -v promtool
need "curl" command -v curl
need "unshare" unshare --user --map-root-user --mount true
need "strace" strace -o /dev/null true
need "PostgreSQL" bash -c "command -v initdb || ls /usr/lib/postgresql/*/bin/initdb"
need "systemd" bash -c "systemd-analyze security --help | grep -q offline"
need "Caddy" command -v caddy
need "shellcheck" command -v shellcheck
need "hadolint" command -v hadolint
need "Docker Compose" bash -c "docker compose version || command -v docker-compose"
need "Node.js" test -x web/node_modules/.bin/vitest -a -e web/dist/node.html

# Enables the feature turbojpeg where it can be built; its tests are named scaled_…
read -ra options <<< "--locked $(bash tests/features.sh)"
left_out=0
[[ "${options[*]}" != *turbojpeg* ]] && left_out=$(grep -rh 'fn scaled_' crates | wc -l)

cargo test "${options[@]}" --no-run || { echo "0 passed, 1 failed, 0 skipped"; exit 1; }

logs=$(mktemp -d)
trap 'rm -rf "$logs"' EXIT
# Runs the given tests, writes their output to the file $1 and shows it. A process that a failed test left behind holds
# only that file open, so that the run ends when the tests end.
run() {
    local output=$1 tests
    shift
    : > "$output"
    cargo test "${options[@]}" --no-fail-fast "$@" >> "$output" 2>&1 &
    tests=$!
    tail -n +1 -f --pid="$tests" "$output"
    wait "$tests"
}
# Runs the tests of the given targets, first the unmarked ones, then the marked ones whose needs are met.
run_targets() {
    local log=$logs/$1 status=0 skip=() what name
    shift
    ALBIREO_SHARED=/nowhere ORT_DYLIB_PATH=/nowhere ALBIREO_PYTHON=/nowhere run "$log" "$@" || status=1
    for what in ${missing[@]+"${missing[@]}"}; do
        local mark="s|^test (.*) \.\.\. ignored, needs (.* and )?$what( and .*)?\$|\1|p"
        while read -r name; do skip+=(--skip "$name"); done < <(sed -nE "$mark" "$log")
    done
    run "$log.marked" "$@" -- --ignored --exact ${skip[@]+"${skip[@]}"} || status=1
    return "$status"
}

for what in ${missing[@]+"${missing[@]}"}; do echo "no $what: the tests that need it are skipped"; done
# Unit tests compute, the others mostly wait: side by side. The output of the unit tests follows when they have ended.
{
    unit=0
    run "$logs/documentation" --doc || unit=1
    run_targets unit --lib || unit=1
    exit "$unit"
} > "$logs/shown" 2>&1 &
unit=$!
status=0
run_targets integration --test '*' || status=1
wait "$unit" || status=1
cat "$logs/shown"

# How many tests of the given logs $1.
count() {
    local what=$1
    shift
    awk -v what="$what" '/^test result:/ { for (i = 1; i < NF; i++) if ($(i + 1) ~ "^" what) n += $i } END { print n + 0 }' "$@"
}
marked=("$logs/unit.marked" "$logs/integration.marked")
all=("$logs/unit" "$logs/integration" "$logs/documentation")
passed=$(count passed "${all[@]}" "${marked[@]}")
failed=$(count failed "${all[@]}" "${marked[@]}")
skipped=$((left_out + $(count ignored "${all[@]}") - $(count passed "${marked[@]}") - $(count failed "${marked[@]}")))
[ "$status" -ne 0 ] && [ "$failed" -eq 0 ] && failed=1
mapfile -t names < <(grep -hE '^test .* \.\.\. FAILED$' "${all[@]}" "${marked[@]}" 2> /dev/null |
    sed -E 's/^test (.*) \.\.\. FAILED$/\1/' | sort -u)
# A few failures may be those of a machine that had too much to do at once: each of them runs once more, alone. A test that
# passes then is told by name, because it should pass beside the others as well.
if [ "${#names[@]}" -gt 0 ] && [ "${#names[@]}" -le 3 ] && [ "$failed" -eq "${#names[@]}" ]; then
    again=$logs/again
    RUST_TEST_THREADS=1 run "$again" --lib --test '*' -- --include-ignored --exact "${names[@]}"
    if [ "$(count passed "$again")" -eq "$failed" ] && [ "$(count failed "$again")" -eq 0 ]; then
        for name in "${names[@]}"; do echo "passed only when it ran alone: $name"; done
        passed=$((passed + failed)) failed=0 status=0 names=()
    fi
fi
# The last lines say what failed, and why what was skipped was.
for name in ${names[@]+"${names[@]}"}; do echo "failed: $name"; done
for what in ${missing[@]+"${missing[@]}"}; do
    echo "skipped: $(grep -hcE "^test .* \.\.\. ignored, needs (.* and )?$what( and .*)?$" "$logs/unit" "$logs/integration" |
        awk '{ n += $1 } END { print n + 0 }') that need $what, which is not here"
done
[ "$left_out" -eq 0 ] || echo "skipped: $left_out of the feature turbojpeg, which needs cmake and nasm"
echo "$passed passed, $failed failed, $skipped skipped"
exit "$status"
