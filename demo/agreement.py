#!/usr/bin/env python3
"""Compares truth.json with labels that somebody drew afresh, and prints the table of README.md.

usage: demo/agreement.py demo/labels-afresh.csv [TRUTH.json]

Each line of the labels is FRAME,CLASS,X1,Y1,X2,Y2 in pixels of the picture at twice its size, 1280x720; FRAME is
CLIP-INDEX, with frames counted from 0, and the class `none` says that there is nothing to label. Boxes are matched one to
one, the largest overlap first, from IoU 0.5 on. A fresh box below the rule's height or mostly in an ignored region counts
neither for nor against.
"""

import csv
import json
import pathlib
import statistics
import sys

LEAST_HEIGHT = 12
LEAST_IOU = 0.5


def shared(a, b):
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    return max(width, 0) * max(height, 0)


def area(box):
    return (box[2] - box[0]) * (box[3] - box[1])


def overlap(a, b):
    return shared(a, b) / (area(a) + area(b) - shared(a, b))


def read_truth(path):
    """Returns labelled boxes and ignored regions by (clip, frame)."""
    truth = {}
    for frame in json.loads(pathlib.Path(path).read_text()):
        boxes, ignored = [], []
        for label in frame["labels"]:
            box = [label["box2d"][side] for side in ("x1", "y1", "x2", "y2")]
            (ignored if label.get("attributes", {}).get("crowd") else boxes).append(box)
        truth[frame["videoName"], frame["frameIndex"]] = boxes, ignored
    return truth


def read_fresh(path):
    fresh = {}
    with open(path, newline="") as file:
        for name, kind, *sides in csv.reader(file):
            clip, index = name.rsplit("-", 1)
            boxes = fresh.setdefault((clip, int(index)), [])
            if kind != "none":
                boxes.append([float(side) / 2 for side in sides])
    return fresh


def matched(truth, fresh):
    """Returns the overlaps of the pairs, and the indices that they use."""
    pairs = sorted(((overlap(t, f), i, j) for i, t in enumerate(truth) for j, f in enumerate(fresh)), reverse=True)
    overlaps, used, taken = [], set(), set()
    for value, i, j in pairs:
        if value >= LEAST_IOU and i not in used and j not in taken:
            overlaps.append(value)
            used.add(i)
            taken.add(j)
    return overlaps, used, taken


def main():
    here = pathlib.Path(__file__).parent
    truth = read_truth(sys.argv[2] if len(sys.argv) > 2 else here / "truth.json")
    rows = {}
    for (clip, frame), fresh in read_fresh(sys.argv[1]).items():
        boxes, ignored = truth[clip, frame]
        overlaps, used, taken = matched(boxes, fresh)
        added = [
            box
            for j, box in enumerate(fresh)
            if j not in taken
            and box[3] - box[1] >= LEAST_HEIGHT
            and not any(2 * shared(box, region) >= area(box) for region in ignored)
        ]
        for name in (clip, "all"):
            row = rows.setdefault(name, {"frames": 0, "boxes": 0, "overlaps": [], "missed": 0, "added": 0})
            row["frames"] += 1
            row["boxes"] += len(boxes)
            row["overlaps"] += overlaps
            row["missed"] += len(boxes) - len(used)
            row["added"] += len(added)
    print("| clip | frames | boxes of the truth | not labelled afresh | labelled afresh only | IoU, median | mean |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name, row in sorted(rows.items(), key=lambda item: (item[0] == "all", item[0])):
        of = row["overlaps"] or [float("nan")]
        print(f"| {name} | {row['frames']} | {row['boxes']} | {row['missed']} | {row['added']} "
              f"| {statistics.median(of):.2f} | {statistics.mean(of):.2f} |")


if __name__ == "__main__":
    main()
