"""Compares a detector at the smallest input that holds the picture with the same detector at its square: the boxes that
albireo finds on clips, and the time of the model. Prints the tables of models/README.md.

    python tests/parity/inputs.py --program target/release/albireo SQUARE.onnx OPEN.onnx CLIP.mp4 ...

SQUARE is an export of one size, OPEN the same model with open height and width. Needs ffmpeg and the PyPI packages
`numpy` and `onnxruntime`, and the ONNX Runtime library in ORT_DYLIB_PATH.
"""

import argparse
import json
import pathlib
import statistics
import subprocess
import tempfile
import time

import numpy
import onnxruntime

SURE = 0.5
LEAST = 0.25
LEAST_OVERLAP = 0.5
TURNS = 25


def overlap(one, other):
    width = min(one["x2"], other["x2"]) - max(one["x1"], other["x1"])
    height = min(one["y2"], other["y2"]) - max(one["y1"], other["y1"])
    shared = max(width, 0) * max(height, 0)
    area = sum((box["x2"] - box["x1"]) * (box["y2"] - box["y1"]) for box in (one, other))
    return shared / (area - shared)


def detected(program, model, folder):
    """Returns what the program prints for each picture of a folder."""
    command = [program, "detect", model, folder, "--json", "--confidence", str(LEAST)]
    ended = subprocess.run(command, check=True, capture_output=True, text=True)
    return [json.loads(line) for line in ended.stdout.splitlines()[1:]]


def paired(found, others, least):
    """Returns for each sure box whether the other size has one of at least this confidence in its place."""
    for box in found["detections"]:
        if box["confidence"] >= SURE:
            yield any(
                other["confidence"] >= least
                and other["class"] == box["class"]
                and overlap(box, other) >= LEAST_OVERLAP
                for other in others["detections"]
            )


def row(program, square, opened, clip, step):
    """Returns a line of the table for one clip. The first pictures are compared at both sizes and run at the square."""
    with tempfile.TemporaryDirectory() as folder:
        pictures = f"{folder}/%05d.png"
        every = f"select=not(mod(n\\,{step}))"
        subprocess.run(
            ["ffmpeg", "-v", "error", "-i", clip, "-vf", every, "-fps_mode", "passthrough", pictures], check=True
        )
        largest, smallest = (detected(program, model, folder) for model in (square, opened))
    both = [(one, other) for one, other in zip(largest, smallest, strict=True) if one["input"] != other["input"]]
    counts = []
    for least in (LEAST, SURE):
        boxes = [pair for one, other in both for a, b in ((one, other), (other, one)) for pair in paired(a, b, least)]
        counts.append((sum(boxes), len(boxes)))
    sizes = sorted({other["input"] for _, other in both}) or ["stays square"]
    (lenient, total), (strict, _) = counts
    print(f"| {clip.stem} | {', '.join(sizes)} | {len(both)} of {len(largest)} | {lenient} of {total} | {strict} of {total} |")
    return lenient, strict, total


def medians(square, opened, columns, rows, threads):
    """Returns the median milliseconds of the square and of the smaller input, taken in turn."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    sessions = [onnxruntime.InferenceSession(str(model), options) for model in (square, opened, opened)]
    side = sessions[0].get_inputs()[0].shape[2]
    pictures = [numpy.full((1, 3, *sides), 114, numpy.float32) for sides in ((side, side), (side, side), (rows, columns))]
    took = [[], [], []]
    for turn in range(TURNS + 3):
        for session, picture, times in zip(sessions, pictures, took, strict=True):
            begun = time.perf_counter()
            session.run(None, {session.get_inputs()[0].name: picture})
            if turn >= 3:
                times.append(1e3 * (time.perf_counter() - begun))
    return [statistics.median(times) for times in took]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="target/release/albireo")
    parser.add_argument("--step", type=int, default=2, help="look at every STEP-th frame [default: 2]")
    parser.add_argument("--size", default="416x256", help="columns x rows of the timed input [default: 416x256]")
    parser.add_argument("square", type=pathlib.Path)
    parser.add_argument("opened", type=pathlib.Path)
    parser.add_argument("clips", type=pathlib.Path, nargs="*")
    arguments = parser.parse_args()
    columns, rows = (int(side) for side in arguments.size.split("x"))
    print("| threads | square, ms | open, square, ms | open, smaller, ms | of the square |\n| --- | ---: | ---: | ---: | ---: |")
    for threads in (1, 2):
        fixed, same, smaller = medians(arguments.square, arguments.opened, columns, rows, threads)
        print(f"| {threads} | {fixed:.1f} | {same:.1f} | {smaller:.1f} | {smaller / fixed:.2f} |")
    print("\n| clip | input | pictures at it | paired | both sure |\n| --- | --- | ---: | ---: | ---: |")
    sums = [
        row(arguments.program, arguments.square, arguments.opened, clip, arguments.step) for clip in arguments.clips
    ]
    lenient, strict, total = (sum(numbers) for numbers in zip(*sums, strict=True)) if sums else (0, 0, 0)
    share = 100 * lenient / max(total, 1)
    print(f"| all | | | **{lenient} of {total} ({share:.1f} %)** | {strict} of {total} |")


if __name__ == "__main__":
    main()
