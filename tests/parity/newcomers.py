"""Judges, on recordings, four cues in grey pictures that the detector would now find something new.

    python3 -m venv cv && cv/bin/pip install opencv-python-headless==5.0.0.93
    albireo eval video *.mp4 --detector yolox_nano_416.onnx --head yolox --policy vanilla --save-detections seen
    cv/bin/python tests/parity/newcomers.py --detections seen --fps 5 *.mp4

A newcomer is a box (score 0.5 or more) that overlaps no box of the last half second and is found in three frames of the
recording. A cue gives each frame a number computed from its picture and the previous one, outside the boxes (0.3 or more)
of the previous frame. The result is the area under the ROC curve: the probability that a frame with a newcomer has a larger
number than one without; a coin toss has 0.5.

    inward      points of a grid that move towards the middle of the picture together with two neighbours, after removal of
                the camera's rotation: stationary things leave the picture of a camera that drives forward
    residual    points that move differently from those around them
    unmatched   textured points at the left and right border that are not found in the previous picture, relative to their
                running mean
    difference  mean difference of the pixels at the left or right border
"""

import argparse
import csv
import json
import pathlib

import cv2
import numpy

WIDTH = 320
SURE, LIKELY = 0.5, 0.3
CUES = ("inward", "residual", "unmatched", "difference")


def overlap(a, b):
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    area = lambda box: (box[2] - box[0]) * (box[3] - box[1])
    return width * height / (area(a) + area(b) - width * height)


def newcomers(frames, frame_rate):
    """Returns the numbers of the frames in which something new begins."""
    tracks = []
    for number, boxes in enumerate(frames):
        for box in (box for box in boxes if box[4] >= SURE):
            recent = [track for track in tracks if number - track[-1][0] <= frame_rate / 2]
            nearest = max(recent, key=lambda track: overlap(track[-1][1], box), default=None)
            if nearest is not None and overlap(nearest[-1][1], box) >= 0.2:
                nearest.append((number, box))
            else:
                tracks.append([(number, box)])
    return {track[0][0] for track in tracks if len({number for number, _ in track}) >= 3}


def motion(before, now):
    """Returns a grid of points of `now`, their motion since `before`, and which of them track back to where they started."""
    height, width = now.shape
    rows, columns = numpy.mgrid[8 : height - 7 : 8, 6 : width - 5 : 10]
    points = numpy.stack([columns.ravel(), rows.ravel()], 1).astype(numpy.float32).reshape(-1, 1, 2)
    follow = lambda a, b, at: cv2.calcOpticalFlowPyrLK(a, b, at, None, winSize=(11, 11), maxLevel=2)
    there, found, _ = follow(now, before, points)
    back, found_back, _ = follow(before, now, there)
    near = numpy.linalg.norm((back - points).reshape(-1, 2), axis=1) < 0.7
    kept = (found.ravel() > 0) & (found_back.ravel() > 0) & near
    return points.reshape(-1, 2), (points - there).reshape(-1, 2), kept, rows.shape


def neighbours(shape, index, reach):
    row, column = divmod(index, shape[1])
    for y in range(max(0, row - reach), min(shape[0], row + reach + 1)):
        for x in range(max(0, column - reach), min(shape[1], column + reach + 1)):
            if (y, x) != (row, column):
                yield y * shape[1] + x


def look(before, now, known):
    """Returns the four numbers of a frame."""
    height, width = now.shape
    points, shift, kept, shape = motion(before, now)
    outside = numpy.ones(len(points), bool)
    for x1, y1, x2, y2, _ in known:
        x, y = points[:, 0] / width, points[:, 1] / height
        outside &= ~((x >= x1 - 0.03) & (x <= x2 + 0.03) & (y >= y1 - 0.03) & (y <= y2 + 0.03))
    far = kept & (abs(points[:, 0] - width / 2) < 0.2 * width) & (points[:, 1] < 0.6 * height)
    turn = numpy.median(shift[far], axis=0) if far.sum() >= 5 else numpy.zeros(2)
    inward = (shift - turn)[:, 0] * numpy.where(points[:, 0] < width / 2, 1, -1)
    moves_in = kept & outside & (inward > 1) & (abs(points[:, 0] - width / 2) > 0.05 * width)
    alike = lambda a, b: (abs(shift[a] - shift[b]) < 0.5 + 0.15 * abs(shift[a][0])).all()
    count = lambda at: sum(moves_in[other] and alike(at, other) for other in neighbours(shape, at, 1))
    together = sum(count(at) >= 2 for at in numpy.flatnonzero(moves_in))
    residual = 0
    for at in numpy.flatnonzero(kept & outside):
        around = [other for other in neighbours(shape, at, 3) if kept[other]]
        if len(around) >= 8:
            residual += numpy.linalg.norm(shift[at] - numpy.median(shift[around], axis=0)) > 2
    slopes = abs(cv2.Sobel(now, cv2.CV_32F, 1, 0)) + abs(cv2.Sobel(now, cv2.CV_32F, 0, 1))
    texture = cv2.boxFilter(slopes, -1, (11, 11))[points[:, 1].astype(int), points[:, 0].astype(int)] > 20
    at_border = abs(points[:, 0] / width - 0.5) > 0.4
    at_border &= abs(points[:, 1] / height - 0.6) < 0.2
    unmatched = (at_border & texture & ~kept & outside).sum()
    changed = cv2.absdiff(before, now)[int(0.45 * height) : int(0.75 * height)]
    strip = int(0.08 * width)
    difference = max(changed[:, :strip].mean(), changed[:, -strip:].mean())
    return together, residual, unmatched, difference


def roc_area(numbers, new):
    numbers, new = numpy.array(numbers, float), numpy.array(new, bool)
    if new.all() or not new.any():
        return float("nan")
    with_one, without = numbers[new][:, None], numbers[~new][None]
    return ((with_one > without) + 0.5 * (with_one == without)).mean()


def judge(video, detections, fps):
    """Returns, for each frame of each thinned clip, whether something new began, and the cues' numbers."""
    sequences = json.loads((detections / "sequences.json").read_text())["sequences"]
    sequence = next(sequence for sequence in sequences if sequence["name"] == video.stem)
    frames = [[] for _ in range(sequence["frames"])]
    with open(detections / "detections" / f"{video.stem}.csv", newline="") as file:
        for row in csv.DictReader(file):
            sides = [sequence["width"], sequence["height"]] * 2
            box = [float(row[name]) / side for name, side in zip(("x1", "y1", "x2", "y2"), sides)]
            frames[int(row["frame"])].append((*box, float(row["score"])))
    capture, pictures = cv2.VideoCapture(str(video)), []
    while (read := capture.read())[0]:
        grey = cv2.cvtColor(read[1], cv2.COLOR_BGR2GRAY)
        size = (WIDTH, round(WIDTH * grey.shape[0] / grey.shape[1]))
        pictures.append(cv2.resize(grey, size, interpolation=cv2.INTER_AREA))
    begins = newcomers(frames, sequence["fps"])
    step = round(sequence["fps"] / fps)
    new, numbers = [], []
    for first in range(step):
        mean = None
        for number in range(first + step, min(len(frames), len(pictures)), step):
            known = [box for box in frames[number - step] if box[4] >= LIKELY]
            found = list(look(pictures[number - step], pictures[number], known))
            mean = found[2] if mean is None else 0.8 * mean + 0.2 * found[2]
            found[2] -= mean
            numbers.append(found)
            new.append(any(number - step < begin <= number for begin in begins))
    return new, numbers


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("videos", nargs="+", type=pathlib.Path)
    parser.add_argument("--detections", required=True, type=pathlib.Path, help="folder of --save-detections")
    parser.add_argument("--fps", type=float, default=5.0, help="frames a second that are looked at")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    print(f"| clip | frames | with a newcomer | {' | '.join(CUES)} |")
    print(f"| --- {'| ---: ' * (2 + len(CUES))}|")
    all_new, all_numbers = [], []

    def row(name, new, numbers):
        areas = [roc_area([number[cue] for number in numbers], new) for cue in range(len(CUES))]
        print(f"| {name} | {len(new)} | {sum(new)} | {' | '.join(f'{area:.2f}' for area in areas)} |", flush=True)

    for video in arguments.videos:
        new, numbers = judge(video, arguments.detections, arguments.fps)
        row(video.stem, new, numbers)
        all_new += new
        all_numbers += numbers
    row("all", all_new, all_numbers)


if __name__ == "__main__":
    main()
