"""Runs the Python package on Ultralytics' results, which it returns as results with ids that can be plotted, and on the rows
that BoxMOT's trackers accept, which it returns in the columns of BoxMOT's tracks. Writes the rows of one result to
crates/python/tests/ultralytics.json for the package's tests. Part of `make parity`."""

import json
import tarfile

import albireo
import boxmot
import cv2
import numpy
import torch
import ultralytics
from boxmot import ByteTrack
from networks import Ultralytics
from pictures import ROAD

RECORDED = ROAD.parents[1] / "crates/python/tests/ultralytics.json"
FRAMES = 12


def road(count):
    """Returns the first pictures of the busy road."""
    with tarfile.open(ROAD) as archive:
        files = [archive.extractfile(f"busy/{number:04}.jpg").read() for number in range(1, count + 1)]
    return [cv2.imdecode(numpy.frombuffer(file, numpy.uint8), cv2.IMREAD_COLOR) for file in files]


def main():
    torch.set_num_threads(2)
    frames = road(FRAMES)
    network = Ultralytics("yolo11n", None)
    network.calibrate([cv2.resize(frame, (network.side, network.side)) for frame in frames[:2]])
    height, width = frames[0].shape[:2]
    skip = albireo.Skipper("fixed-skip-in-tracker", threshold=2, size=(width, height))
    asked = 0
    for number, frame in enumerate(frames):
        if skip.wants_detector(number):
            [result] = network.model.predict(frame, conf=0.4, iou=0.1, max_det=12, device="cpu", verbose=False)
            shown, asked = skip.update(result), asked + 1
            if number == 0:
                record(result)
        else:
            shown = skip.predict(frame)
        assert type(shown) is type(result), type(shown)
        boxes = shown.boxes
        assert boxes.data.dtype == result.boxes.data.dtype and boxes.data.device == result.boxes.data.device
        assert len(boxes) > 0 and boxes.is_track and len(set(boxes.id.tolist())) == len(boxes)
        assert shown.names == result.names and shown.orig_shape == result.orig_shape
        assert shown.plot().shape == frame.shape
        assert len(shown.source) == len(boxes)
    assert asked == FRAMES // 2, asked
    rows(network, frames)
    print(f"Ultralytics {ultralytics.__version__}: {FRAMES} frames, {asked} detector calls, results with ids on all")


def rows(network, frames):
    """Runs BoxMOT's ByteTrack and albireo on the same rows: on frames with detections both return one track for each."""
    theirs = ByteTrack()
    height, width = frames[0].shape[:2]
    ours = albireo.Skipper("fixed-skip-in-tracker", threshold=2, size=(width, height))
    [result] = network.model.predict(frames[0], conf=0.4, iou=0.1, max_det=12, device="cpu", verbose=False)
    found = result.boxes.data.numpy()
    for number in range(FRAMES):
        tracks = theirs.update(found, frames[0])
        shown = ours.update(found) if ours.wants_detector(number) else ours.predict()
        # x1, y1, x2, y2, id, confidence, class; BoxMOT adds the detection's index.
        for columns in (numpy.asarray(tracks)[:, :7], shown):
            assert len(columns) == len(found), (number, len(columns), len(found))
            columns = columns[numpy.lexsort(columns[:, :4].round().T)]
            expected = found[numpy.lexsort(found[:, :4].round().T)]
            assert numpy.abs(columns[:, :4] - expected[:, :4]).max() < 2
            assert len(set(columns[:, 4].tolist())) == len(found)
            assert numpy.array_equal(columns[:, 6], expected[:, 5])
    print(f"BoxMOT {boxmot.__version__}: {FRAMES} frames, {len(found)} tracks in the same columns")


def record(result):
    """Returns the rows of `result` unchanged: x1, y1, x2, y2, confidence, class."""
    rows = result.boxes.data.numpy()
    assert rows.shape[1] == 6 and rows.dtype == numpy.float32
    recorded = {
        "ultralytics": ultralytics.__version__,
        "orig_shape": list(result.orig_shape),
        "names": {number: name for number, name in result.names.items() if number in rows[:, 5]},
        "rows": [[float(value) for value in row] for row in rows],
    }
    lines = [f'"{key}": {json.dumps(value)}' for key, value in recorded.items() if key != "rows"]
    rows = ",\n  ".join(json.dumps(row) for row in recorded["rows"])
    RECORDED.write_text("{\n" + ",\n".join([*lines, f'"rows": [\n  {rows}\n]']) + "\n}\n")


if __name__ == "__main__":
    main()
