#!/usr/bin/env bash
# Counts the instructions of the frames that must not become dearer unseen, and compares them with benches/counted.txt: an
# instruction more is seen on a busy machine, too, where a time says nothing. `make bench-counted` and CI call it; it needs
# valgrind. ACCEPT=1 writes the counts of this tree into the file.
set -euo pipefail
cd "$(dirname "$0")/.."
reference=benches/counted.txt
# A count may differ by so many percent, up or down.
allowed=2

if ! command -v valgrind >/dev/null 2>&1; then
    echo "valgrind is missing: sudo apt-get install valgrind, or \`make debian\`" >&2
    exit 1
fi
# The figures are those of one compiler and one kind of processor.
machine="$(rustc --version | cut -d' ' -f1,2) on $(uname -m)"

# Optimised, and only what the bench needs; its symbols are not used.
built=$(cargo bench --locked -p albireo-wire --bench counted --no-run 2>&1) || { echo "$built" >&2; exit 1; }
program=$(sed -nE 's/.*\((.*counted-[0-9a-f]+)\).*/\1/p' <<<"$built" | tail -n 1)

# glibc and allocators choose copies by the processor: here always the same. No code of ours chooses by it.
export GLIBC_TUNABLES=glibc.cpu.x86_rep_movsb_threshold=1000000:glibc.cpu.hwcaps=-AVX2,-AVX,-AVX512F,-AVX512VL,-ERMS,-FSRM
# The instructions of one run of case $1 with $2 objects and $3 laps.
instructions() {
    valgrind --tool=callgrind --callgrind-out-file=/dev/null "$program" "$1" "$2" "$3" 2>&1 |
        sed -nE 's/.*Collected : ([0-9]+).*/\1/p'
}
# A lap has 100 frames; two laps more than none make 200.
count() {
    local few many
    few=$(instructions "$1" "$2" 0)
    many=$(instructions "$1" "$2" 2)
    echo $(((many - few) / 200))
}

results=$(mktemp)
trap 'rm -f "$results"' EXIT
cases=()
for objects in 10 30 100 300; do cases+=("albireo/detector $objects" "expected-loss/detector $objects"); done
for objects in 30 100; do cases+=("albireo-reference/detector $objects"); done
for objects in 10 100; do cases+=("albireo/predicted $objects" "albireo/answered $objects"); done
export -f instructions count
export program
# Counts do not depend on what runs beside them.
# shellcheck disable=SC2016 # the inner shell expands it
printf '%s\n' "${cases[@]}" | xargs -P "$(nproc)" -I{} bash -c 'set -- {}; echo "$1 $2 $(count "$1" "$2")"' >"$results"
if [ "$(awk 'NF == 3 && $3 > 0' "$results" | wc -l)" -ne "${#cases[@]}" ]; then
    echo "not every case was counted:" >&2
    cat "$results" >&2
    exit 1
fi
sort -k1,1 -k2,2n -o "$results" "$results"

if [ -n "${ACCEPT:-}" ]; then
    {
        echo "# Instructions of a frame, by \`make bench-counted ACCEPT=1\` with $machine: policy/case, objects, instructions."
        cat "$results"
    } >"$reference"
    cat "$reference"
    exit 0
fi

measured_with=$(sed -nE '1s/.* with (.*): policy.*/\1/p' "$reference")
judged=1
[ "$measured_with" = "$machine" ] || judged=0
awk -v allowed="$allowed" -v judged="$judged" '
    FNR == NR { if ($1 !~ /^#/) before[$1 " " $2] = $3; next }
    {
        name = $1 " " $2
        if (!(name in before)) { printf "%-26s %4d %10d  new\n", $1, $2, $3; moved++; next }
        percent = 100 * ($3 / before[name] - 1)
        far = percent > allowed || percent < -allowed
        printf "%-26s %4d %10d  %+6.2f %%%s\n", $1, $2, $3, percent, far ? "  was " before[name] : ""
        moved += far
        delete before[name]
    }
    END {
        for (name in before) { print name ": is not counted any more"; moved++ }
        exit moved > 0 && judged
    }' "$reference" "$results" && fits=1 || fits=0
if [ "$judged" -eq 0 ]; then
    echo "not judged: $reference was counted with $measured_with, and this is $machine; ACCEPT=1 writes the new counts" >&2
elif [ "$fits" -eq 0 ]; then
    echo "The instructions of a frame moved by more than $allowed % (the lines with \"was\", \"new\" or \"not counted\")." >&2
    echo "If that is meant, \`make bench-counted ACCEPT=1\` writes the new counts; say why in the commit." >&2
    exit 1
fi
