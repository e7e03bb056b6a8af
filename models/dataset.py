"""Reads folders written by `albireo synth` and keeps them as small arrays for training.

A folder holds JPEG pictures and `ground_truth.jsonl`. For the detector each picture is scaled to fit
320 x 192 as the program's letterbox does it (bilinear, without antialiasing); for the screen it is
scaled to 640 x 360. Arrays are cached beside the pictures as .npy files.
"""

import json
from pathlib import Path

import numpy as np
from PIL import Image

CLASSES = ["pedestrian", "rider", "car", "truck", "bus", "motorcycle", "bicycle"]
DETECTOR_SIZE = (320, 192)  # columns, rows of the network's input
SCREEN_SIZE = (640, 360)
MOST_BOXES = 64
PADDING = 114


def read_lines(folder):
    """The frames of a folder, in the order of its listing."""
    with open(Path(folder) / "ground_truth.jsonl", encoding="utf-8") as listing:
        return [json.loads(line) for line in listing]


def bilinear(picture, columns, rows):
    """Two-tap bilinear scaling with half-pixel centres, no antialiasing, of an [h, w, 3] uint8 array."""
    height, width = picture.shape[:2]

    def taps(size, count):
        at = np.clip((np.arange(count) + 0.5) * size / count - 0.5, 0, size - 1)
        low = np.floor(at).astype(int)
        return low, np.minimum(low + 1, size - 1), (at - low).astype(np.float32)

    top, bottom, down = taps(height, rows)
    left, right, along = taps(width, columns)
    picture = picture.astype(np.float32)
    picture = picture[top] * (1 - down)[:, None, None] + picture[bottom] * down[:, None, None]
    picture = picture[:, left] * (1 - along)[None, :, None] + picture[:, right] * along[None, :, None]
    return np.round(picture).astype(np.uint8)


def letterbox_size(width, height):
    """Columns and rows a picture takes in the detector's input, and the scale."""
    scale = min(DETECTOR_SIZE[0] / width, DETECTOR_SIZE[1] / height)
    return round(width * scale), round(height * scale), scale


def detector_arrays(folder):
    """Pictures [n, 192, 320, 3] uint8 and boxes [n, MOST_BOXES, 7] float32.

    A row of boxes is x1, y1, x2, y2 in input pixels, class, ignore (0 or 1), height at 720 rows;
    unused rows have class -1.
    """
    folder = Path(folder)
    lines = read_lines(folder)
    stored = folder / "detector.npy"
    if not stored.exists():
        columns, rows = DETECTOR_SIZE
        out = np.lib.format.open_memmap(
            folder / "partial.npy", "w+", np.uint8, (len(lines), rows, columns, 3)
        )
        for index, line in enumerate(lines):
            with Image.open(folder / line["file"]) as file:
                picture = np.asarray(file.convert("RGB"))
            width, height, scale = letterbox_size(line["width"], line["height"])
            if index % 4 == 3:
                # Some pictures antialiased, so that the network does not depend on the kind of scaling.
                scaled = np.asarray(Image.fromarray(picture).resize((width, height), Image.BILINEAR))
            else:
                scaled = bilinear(picture, width, height)
            out[index] = PADDING
            out[index, :height, :width] = scaled
        out.flush()
        (folder / "partial.npy").rename(stored)
    boxes = np.full((len(lines), MOST_BOXES, 7), -1.0, np.float32)
    for index, line in enumerate(lines):
        _, _, scale = letterbox_size(line["width"], line["height"])
        for slot, found in enumerate(line["objects"][-MOST_BOXES:]):
            corners = [found[key] * scale for key in ("x1", "y1", "x2", "y2")]
            tall = (found["y2"] - found["y1"]) * 720.0 / line["height"]
            boxes[index, slot] = [*corners, found["class"], float(found["ignore"]), tall]
    return np.load(stored, mmap_mode="r"), boxes


def screen_arrays(folder, every=1):
    """Pictures [n, 360, 640, 3] uint8 and labels: 0 empty, 1 non-empty.

    Empty means that the ground truth has no object at all; a frame whose only objects are ones a
    detector need not find (tiny, hidden) is left out, for it is neither.
    """
    folder = Path(folder)
    chosen = [line for line in read_lines(folder)[::every]]
    labels = np.array([label(line) for line in chosen])
    kept = [line for line, found in zip(chosen, labels) if found >= 0]
    stored = folder / f"screen-{every}.npy"
    if not stored.exists():
        columns, rows = SCREEN_SIZE
        out = np.lib.format.open_memmap(
            folder / "partial.npy", "w+", np.uint8, (len(kept), rows, columns, 3)
        )
        for index, line in enumerate(kept):
            with Image.open(folder / line["file"]) as file:
                out[index] = bilinear(np.asarray(file.convert("RGB")), columns, rows)
        out.flush()
        (folder / "partial.npy").rename(stored)
    return np.load(stored, mmap_mode="r"), labels[labels >= 0]


def label(line):
    """0 empty, 1 non-empty, -1 neither."""
    if not line["objects"]:
        return 0
    return 1 if any(not found["ignore"] for found in line["objects"]) else -1
