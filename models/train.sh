#!/bin/sh
# Draws the data and trains both demonstration models, as the model card says.
# Wants the `albireo` program on the path and the Python packages of requirements.txt.
# Takes about 7 GB of disk in the folder given (default: ./training-data).
set -eu
models=$(cd "$(dirname "$0")" && pwd)
data=${1:-training-data}
mkdir -p "$data"

albireo synth --out "$data/train-a" --seeds 1-150 --frames 24 --every 25 --first 3
albireo synth --out "$data/train-b" --seeds 151-300 --frames 24 --every 25 --first 9
albireo synth --out "$data/held" --seeds 100001-100030 --frames 24 --every 25 --first 5

train="$data/train-a $data/train-b"
# shellcheck disable=SC2086 # two folders
{
    python3 "$models/train_detector.py" --train $train --held-out "$data/held" \
        --out "$data/first.onnx"
    python3 "$models/train_detector.py" --train $train --held-out "$data/held" \
        --resume "$data/first.onnx.pt" --epochs 7 --rate 2.5e-3 --seed 2 --out "$data/detector.onnx"
    python3 "$models/train_screen.py" --train $train --held-out "$data/held" --out "$data/screen.onnx"
}
cp "$data/detector.onnx" "$data/screen.onnx" "$models/"
