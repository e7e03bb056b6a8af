#!/usr/bin/env bash
# Fetches the ONNX Runtime library from its wheel on PyPI, so that no other download site is needed, and
# puts it with its licences into $1 (default .cache/onnxruntime). Does nothing if the library is already
# there. Needs Python 3 with pip; the wheel is checked against the SHA-256 pinned below.
set -euo pipefail

version=1.31.1
target=${1:-.cache/onnxruntime}
library=libonnxruntime.so.$version

# Another machine's library is fetched by naming it: x86_64 or aarch64.
machine=${ONNXRUNTIME_MACHINE:-$(uname -m)}
case "$(uname -s)/$machine" in
Linux/x86_64) sha256=5752bd508126ae7c49894d3b9d2e83f0c3d487319246d04c444b393308d7ad7f ;;
Linux/aarch64) sha256=da05378364c44d4407e463982d2bf8d5e4cfea873283757e48beeb41df97b7f3 ;;
*)
    echo "no ONNX Runtime wheel is pinned for $(uname -s) on $machine: install ONNX Runtime 1.22 or newer" \
        "and name its library in ORT_DYLIB_PATH" >&2
    exit 1
    ;;
esac

if [ -s "$target/$library" ] && [ -s "$target/LICENSE" ] && [ -s "$target/ThirdPartyNotices.txt" ]; then
    exit 0
fi

mkdir -p "$target"
work=$(mktemp -d "$target/fetch.XXXXXX")
trap 'rm -rf "$work"' EXIT

# pip compares the hash before it keeps the file. The wheel of any Python version holds the same library;
# naming one makes the hash independent of the Python that happens to be here.
echo "onnxruntime==$version --hash=sha256:$sha256" >"$work/requirements.txt"
python3 -m pip download --quiet --disable-pip-version-check --no-deps --only-binary=:all: \
    --implementation cp --python-version 3.11 --platform "manylinux_2_28_$machine" \
    --require-hashes --requirement "$work/requirements.txt" --dest "$work"

python3 - "$work" "$library" <<'PYTHON'
import pathlib, shutil, sys, zipfile

work, library = pathlib.Path(sys.argv[1]), sys.argv[2]
[wheel] = work.glob("*.whl")
with zipfile.ZipFile(wheel) as files:
    for member in (
        f"onnxruntime/capi/{library}",
        "onnxruntime/LICENSE",
        "onnxruntime/ThirdPartyNotices.txt",
    ):
        with files.open(member) as source, open(work / pathlib.PurePath(member).name, "wb") as destination:
            shutil.copyfileobj(source, destination)
PYTHON

# The library goes last: while it is missing, the next call starts again.
mv "$work/LICENSE" "$work/ThirdPartyNotices.txt" "$target/"
mv "$work/$library" "$target/"
echo "ONNX Runtime $version is in $target"
