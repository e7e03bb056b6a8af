"""Compares a detector at the smallest input that holds the picture with the same detector at its square: the boxes that
albireo finds on clips, the boxes without a pair, and the time of the model. Prints the tables of models/README.md.

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


def side_of(square):
    """Returns the side of the square: YOLOv5 writes none into an export with open sides."""
    return onnxruntime.InferenceSession(str(square)).get_inputs()[0].shape[2]


def detected(program, model, side, folder):
    """Returns what the program prints for each picture of a folder."""
    size = f"{side}x{side}"
    command = [program, "detect", model, folder, "--json", "--confidence", str(LEAST), "--input-size", size]
    ended = subprocess.run(command, check=True, capture_output=True, text=True)
    return [json.loads(line) for line in ended.stdout.splitlines()[1:]]


def nearest(box, others):
    """Returns the box of the other size that overlaps this one most, of whatever class and confidence, and by how much."""
    return max(((other, overlap(box, other)) for other in others), key=lambda pair: pair[1], default=(None, 0))


def is_paired(box, others, least):
    """Returns whether the other size has a box of this class and at least this confidence in its place."""
    return any(
        other["confidence"] >= least and other["class"] == box["class"] and overlap(box, other) >= LEAST_OVERLAP
        for other in others
    )


def words(box):
    return f"{box['class_name']} {box['confidence']:.2f}"


def difference(clip, found, box, others):
    """Returns a line of the list of sure boxes without a pair."""
    other, share = nearest(box, others["detections"])
    instead = f"{words(other)}, IoU {share:.2f}" if share > 0 else "nothing"
    sides = f"{box['x2'] - box['x1']:.0f}x{box['y2'] - box['y1']:.0f}"
    picture = pathlib.Path(found["picture"]).stem
    return f"| {clip.stem} | {picture} | {words(box)}, {sides} | {found['input']} | {instead} |"


def row(program, square, opened, clip, step):
    """Prints a line of the table for one clip; returns its counts and its boxes without a pair. The first pictures are
    compared at both sizes and run at the square."""
    with tempfile.TemporaryDirectory() as folder:
        pictures = f"{folder}/%05d.png"
        every = f"select=not(mod(n\\,{step}))"
        subprocess.run(
            ["ffmpeg", "-v", "error", "-i", clip, "-vf", every, "-fps_mode", "passthrough", pictures], check=True
        )
        side = side_of(square)
        largest, smallest = (detected(program, model, side, folder) for model in (square, opened))
    both = [(one, other) for one, other in zip(largest, smallest, strict=True) if one["input"] != other["input"]]
    sure = [
        (found, box, others)
        for pair in both
        for found, others in (pair, pair[::-1])
        for box in found["detections"]
        if box["confidence"] >= SURE
    ]
    apart = [(found, box, others) for found, box, others in sure if not is_paired(box, others["detections"], LEAST)]
    strict = sum(is_paired(box, others["detections"], SURE) for _, box, others in sure)
    total = len(sure)
    lenient = total - len(apart)
    sizes = sorted({other["input"] for _, other in both}) or ["stays square"]
    at_it = f"{len(both)} of {len(largest)}"
    print(f"| {clip.stem} | {', '.join(sizes)} | {at_it} | {lenient} of {total} | {strict} of {total} |", flush=True)
    return (lenient, strict, total), [difference(clip, *found) for found in apart]


def medians(square, opened, columns, rows, threads):
    """Returns for the square, the open model at the square and the smaller input, taken in turn, the median milliseconds
    on the clock and of the processor."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    sessions = [onnxruntime.InferenceSession(str(model), options) for model in (square, opened, opened)]
    side = side_of(square)
    pictures = [numpy.full((1, 3, *sides), 114, numpy.float32) for sides in ((side, side), (side, side), (rows, columns))]
    took = [[], [], []]
    for turn in range(TURNS + 3):
        for session, picture, times in zip(sessions, pictures, took, strict=True):
            begun = time.perf_counter(), time.process_time()
            session.run(None, {session.get_inputs()[0].name: picture})
            ended = time.perf_counter(), time.process_time()
            if turn >= 3:
                times.append([1e3 * (end - begin) for begin, end in zip(begun, ended, strict=True)])
    return [[statistics.median(one) for one in zip(*times, strict=True)] for times in took]


def times(square, opened, columns, rows):
    """Prints the table of times."""
    print(
        f"| threads, {TURNS} runs in turn | square, ms | open, square, ms | open, {columns}x{rows}, ms | of the square |\n"
        "| --- | ---: | ---: | ---: | ---: |"
    )
    for threads in (1, 2):
        measured = medians(square, opened, columns, rows, threads)
        for clock, (fixed, same, smaller) in zip(("clock", "processor"), zip(*measured, strict=True), strict=True):
            print(f"| {threads}, {clock} | {fixed:.1f} | {same:.1f} | {smaller:.1f} | {smaller / fixed:.2f} |", flush=True)


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
    times(arguments.square, arguments.opened, columns, rows)
    print("\n| clip | input | pictures at it | paired | both sure |\n| --- | --- | ---: | ---: | ---: |")
    counts, apart = [], []
    for clip in arguments.clips:
        numbers, differences = row(arguments.program, arguments.square, arguments.opened, clip, arguments.step)
        counts.append(numbers)
        apart += differences
    lenient, strict, total = map(sum, zip(*counts, strict=True)) if counts else (0, 0, 0)
    share = 100 * lenient / max(total, 1)
    print(f"| all | | | **{lenient} of {total} ({share:.1f} %)** | {strict} of {total} |")
    if apart:
        print("\n| clip | picture | box without a pair | input | the nearest at the other |\n| --- | --- | --- | --- | --- |")
        print("\n".join(apart))


if __name__ == "__main__":
    main()
