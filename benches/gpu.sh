#!/usr/bin/env bash
# Measures what one NVIDIA GPU does for the node and writes benches/gpu.md; `make gpu` calls it. Set by variables:
#   PROVIDER=cuda|tensorrt|cpu   what runs the models; cpu is a trial of this script, short and marked as such
#   MODELS="a.onnx b.onnx"       detectors; without it those at hand. Variants are made beside them: float16, an open batch
#   CAMERA_MODELS="a.onnx"       detectors that cameras are put on; without it YOLOX-Nano
#   POLICIES="vanilla albireo=5e-4 expected-loss"    what decides for the cameras
#   LIMIT=60                     longest time for one piece, seconds; TensorRT needs minutes for its engines
#   AGAIN=1                      measures everything anew, also what a run that was cut has left
#   RUNS SECONDS_EACH MOST_CAMERAS DEVICE OUT        see cargo bench --bench gpu -- --help
#   GPU_BENCH=… ALBIREO_BIN=…    the bench and the program, built elsewhere: for a machine without Rust
# Variants need Python with the packages of benches/gpu/requirements.txt (GPU_PYTHON names one); without them they are left out.
set -euo pipefail
cd "$(dirname "$0")/.."

provider=${PROVIDER:-cuda}
read -ra models <<<"${MODELS:-models/yolox_nano.onnx}"
read -ra camera_models <<<"${CAMERA_MODELS:-models/yolox_nano.onnx}"
if [ "$provider" = cpu ]; then
    : "${RUNS:=30}" "${SECONDS_EACH:=3}" "${MOST_CAMERAS:=4}"
elif [ "$provider" = tensorrt ]; then
    : "${LIMIT:=1800}"
fi

python=${GPU_PYTHON:-.cache/gpu/python/bin/python}
has_packages() { "$python" -c 'import onnx, onnxconverter_common' 2>/dev/null; }
install_packages() {
    # Anew: an installation that was cut short would stay as it is.
    rm -rf .cache/gpu/python
    python3 -m venv .cache/gpu/python
    "$python" -m pip install --quiet --disable-pip-version-check -r benches/gpu/requirements.txt
}
if [ -z "${GPU_PYTHON:-}" ] && ! has_packages; then
    # In a process of its own, which ends with the first command that fails.
    (install_packages) & wait $! || true
fi
if has_packages; then
    made=$("$python" benches/gpu/variants.py .cache/gpu/models "${models[@]}")
    [ -z "$made" ] || mapfile -t -O "${#models[@]}" models <<<"$made"
else
    echo "no Python with the packages of benches/gpu/requirements.txt: half precision and open batches are left out" >&2
fi

arguments=(--provider "$provider" --date "$(date +%F)")
for model in "${models[@]}"; do arguments+=(--model "$model"); done
for model in "${camera_models[@]}"; do arguments+=(--camera-model "$model"); done
for policy in ${POLICIES:-}; do arguments+=(--policy "$policy"); done
[ -z "${LIMIT:-}" ] || arguments+=(--limit "$LIMIT")
[ -z "${AGAIN:-}" ] || arguments+=(--again)
[ -z "${RUNS:-}" ] || arguments+=(--runs "$RUNS")
[ -z "${SECONDS_EACH:-}" ] || arguments+=(--seconds "$SECONDS_EACH")
[ -z "${MOST_CAMERAS:-}" ] || arguments+=(--most-cameras "$MOST_CAMERAS")
[ -z "${DEVICE:-}" ] || arguments+=(--device "$DEVICE")
[ -z "${OUT:-}" ] || arguments+=(--out "$OUT")

if [ -n "${GPU_BENCH:-}" ]; then
    run=("$GPU_BENCH")
else
    run=(cargo bench --locked --bench gpu --)
fi
if ! "${run[@]}" "${arguments[@]}"; then
    echo "Without a GPU, \`make gpu PROVIDER=cpu\` tries the script with the processor." >&2
    exit 1
fi
