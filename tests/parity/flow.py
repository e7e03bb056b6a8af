"""Tracks points with OpenCV's calcOpticalFlowPyrLK, as a reference for crates/core/src/flow.

    python3 -m venv cv && cv/bin/pip install opencv-python-headless==5.0.0.93
    cv/bin/python tests/parity/flow.py --out tests/fixtures/flow --crop 60,56,192,104 --pairs A.jpg:B.jpg …

writes a fixture; that in tests/fixtures/flow was made from drawn streets. The test can also read a folder made from other
pictures, if ALBIREO_FLOW_FIXTURE names it:

    ffmpeg -i clip.mp4 -vf scale=320:-2,format=gray clip-%04d.png
    cv/bin/python tests/parity/flow.py --out /tmp/clip --every 5 --pictures clip-*.png
    ALBIREO_FLOW_FIXTURE=/tmp/clip cargo test -p albireo-core opencv -- --nocapture

A folder contains the pictures as PGM and `points.json`: for each pair of pictures the points of a regular grid, where
OpenCV finds them, and the distance after tracking back (-1 where OpenCV finds nothing).
"""

import argparse
import json
import pathlib

import cv2
import numpy

WINDOW = 11
LEVELS = 3
DISTANCE = 8
STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)


def read(file, crop):
    """Reads a picture in grey, scaled to a width of 320 pixels and cropped to `crop`."""
    grey = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    if grey.shape[1] != 320:
        height = round(grey.shape[0] * 320 / grey.shape[1])
        grey = cv2.resize(grey, (320, height), interpolation=cv2.INTER_AREA)
    if crop:
        x, y, width, height = crop
        grey = grey[y : y + height, x : x + width]
    return numpy.ascontiguousarray(grey)


def follow(before, after, points):
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        before, after, points, None, winSize=(WINDOW, WINDOW), maxLevel=LEVELS - 1, criteria=STOP, minEigThreshold=1e-4
    )
    return found, status.ravel() == 1


def compare(before, after):
    height, width = before.shape
    places = [(x, y) for y in range(4, height, DISTANCE) for x in range(4, width, DISTANCE)]
    points = numpy.array(places, numpy.float32).reshape(-1, 1, 2)
    found, there = follow(before, after, points)
    back, here = follow(after, before, found)
    distance = numpy.linalg.norm((back - points).reshape(-1, 2), axis=1)
    distance[~(there & here)] = -1
    rows = zip(points.reshape(-1, 2), found.reshape(-1, 2), distance, strict=True)
    return [[float(x), float(y), round(float(u), 4), round(float(v), 4), round(float(d), 4)] for (x, y), (u, v), d in rows]


def chosen(arguments):
    """Returns the pairs of files to compare."""
    for pair in arguments.pairs:
        # before:after
        yield tuple(pathlib.Path(file) for file in pair.split(":"))
    files = sorted(arguments.pictures)
    for index in range(0, len(files) - arguments.step, arguments.every):
        yield files[index], files[index + arguments.step]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--pictures", type=pathlib.Path, nargs="*", default=[])
    parser.add_argument("--every", type=int, default=1, help="a pair begins at every n-th of the pictures")
    parser.add_argument("--step", type=int, default=1, help="pictures from the first of a pair to the second")
    parser.add_argument("--pairs", nargs="*", default=[], help="single pairs, before:after")
    parser.add_argument("--crop", type=lambda text: [int(n) for n in text.split(",")], help="x,y,width,height")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    pairs = []
    for number, files in enumerate(chosen(arguments)):
        pictures = [read(file, arguments.crop) for file in files]
        names = [f"{number:04}{side}.pgm" for side in "ab"]
        for name, picture in zip(names, pictures, strict=True):
            cv2.imwrite(str(arguments.out / name), picture)
        pairs.append({"before": names[0], "after": names[1], "points": compare(*pictures)})
    text = json.dumps({"opencv": cv2.__version__, "pairs": pairs}, separators=(",", ":"))
    (arguments.out / "points.json").write_text(text + "\n")
    print(len(pairs), "pairs in", arguments.out)


if __name__ == "__main__":
    main()
