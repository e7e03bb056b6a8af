#!/usr/bin/env bash
# Makes the environment that the Python package is tested in, with the wheel in it. What the README's example wants is kept
# as files beside it, so that a test installs them without a network.
set -euo pipefail
root=$(realpath "$(dirname "$0")/../../..")
environment=${1:?usage: environment.sh FOLDER}
requirements=$root/crates/python/tests/requirements.txt
[ -x "$environment/bin/python" ] || python3 -m venv "$environment"
pip=("$environment/bin/python" -m pip --disable-pip-version-check --quiet)
"${pip[@]}" install --no-compile --requirement "$requirements"
# Its metrics need no more than NumPy and SciPy, which supervision brings; with all its data sets it brings OpenCV.
"${pip[@]}" install --no-compile --no-deps trackeval==1.3.0
"${pip[@]}" install --force-reinstall --no-deps "$root"/target/wheels/albireo-*.whl
grep -E '^(numpy|onnxruntime|pillow)==' "$requirements" | "${pip[@]}" download --dest "$environment/files" --requirement /dev/stdin
