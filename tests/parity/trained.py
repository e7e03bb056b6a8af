"""Measures the effect of different resizing on trained networks: the same detector on pictures resized by albireo and on
squares resized by OpenCV."""

import pathlib

import cv2
import numpy

from detect import detect

CONFIDENCE = 0.3


def corner(picture, side):
    """Places the picture in the top-left corner of a grey square, like YOLOX; also returns the factor for boxes."""
    rows, columns = picture.shape[:2]
    scale = min(side / rows, side / columns)
    size = int(columns * scale), int(rows * scale)
    square = numpy.full((side, side, 3), 114, numpy.uint8)
    square[: size[1], : size[0]] = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
    return square, (1 / scale, 1 / scale)


def stretched(picture, side):
    """Stretches the picture to a square, like FastestDet."""
    rows, columns = picture.shape[:2]
    return cv2.resize(picture, (side, side), interpolation=cv2.INTER_LINEAR), (columns / side, rows / side)


def rows(program, shared, files, folder):
    """Returns a line of the table for each network."""
    lines = []
    for name, side, fit in (
        ("yolox_nano_416", 416, corner),
        ("fastestdet_352", 352, stretched),
    ):
        model = pathlib.Path(shared) / "models" / f"{name}.onnx"
        squares, scales = [], []
        for file in files:
            square, scale = fit(cv2.imread(str(file)), side)
            squares.append(pathlib.Path(folder) / f"{file.stem}_{name}.png")
            squares[-1].parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(squares[-1]), square)
            scales.append(numpy.array([*scale, *scale, 1, 1]))
        _, own = detect(program, model, files, pathlib.Path(folder) / "own", CONFIDENCE)
        _, other = detect(program, model, squares, pathlib.Path(folder) / "other", CONFIDENCE)
        pixels, scores, alone, boxes, levels = [], [], 0, 0, []
        for (mine, given), (theirs, given_other), scale in zip(own, other, scales, strict=True):
            factor = 255 if given.max() <= 1 else 1
            levels.append(numpy.abs(given - given_other).ravel() * factor)
            theirs = theirs * scale
            boxes += len(theirs)
            free = list(range(len(mine)))
            for row in theirs:
                same = [place for place in free if mine[place, 5] == row[5]]
                near = [numpy.abs(mine[place, :4] - row[:4]).max() for place in same]
                if not near or min(near) > 32:
                    alone += 1
                    continue
                best = same[int(numpy.argmin(near))]
                free.remove(best)
                pixels.append(min(near))
                scores.append(abs(mine[best, 4] - row[4]))
            alone += len(free)
        levels = numpy.concatenate(levels)
        lines.append(
            f"| {name} | {len(files)} | {levels.max():.2f} / {levels.mean():.3f} | {boxes} | {alone} "
            f"| {numpy.median(pixels):.2f} / {max(pixels):.2f} | {numpy.median(scores):.4f} / {max(scores):.4f} |"
        )
    return lines
