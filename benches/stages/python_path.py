"""A frame's way in Python, as Ultralytics goes it: OpenCV decodes and letterboxes, NumPy makes the tensor, ONNX
Runtime's own session runs the model, OpenCV suppresses. `cargo bench --bench stages -- --python PYTHON` starts it:
it prints its versions, then for every line it reads one JSON line with milliseconds of each stage and frame.

python_path.py MODEL FOLDER HEAD THREADS"""

import json
import pathlib
import sys
import time

import cv2
import numpy
import onnxruntime

CONFIDENCE = 0.5
OVERLAP = 0.45
GREY = (114, 114, 114)


def letterbox(picture, rows, columns, head):
    height, width = picture.shape[:2]
    scale = min(rows / height, columns / width)
    new_width = round(width * scale)
    new_height = round(height * scale)
    resized = cv2.resize(picture, (new_width, new_height), interpolation=cv2.INTER_LINEAR)
    free_columns = columns - new_width
    free_rows = rows - new_height
    left = 0 if head == "yolox" else free_columns // 2
    top = 0 if head == "yolox" else free_rows // 2
    bottom = free_rows - top
    right = free_columns - left
    padded = cv2.copyMakeBorder(resized, top, bottom, left, right, cv2.BORDER_CONSTANT, value=GREY)
    planes = padded if head == "yolox" else padded[..., ::-1]
    tensor = numpy.ascontiguousarray(planes.transpose(2, 0, 1)[None], dtype=numpy.float32)
    if head != "yolox":
        tensor /= 255
    return tensor, scale, left, top


def yolox_grid(rows, columns):
    """Column, row and stride of every cell."""
    cells = []
    for stride in (8, 16, 32):
        y, x = numpy.mgrid[: rows // stride, : columns // stride]
        cells.append(numpy.stack([x.ravel(), y.ravel(), numpy.full(x.size, stride)], 1))
    return numpy.concatenate(cells).astype(numpy.float32)


def read(output, head, grid):
    """x, y, width, height and the scores of all classes, for what may be above the confidence."""
    if head == "end-to-end":
        rows = output[output[:, 4] >= CONFIDENCE]
        return numpy.hstack([rows[:, :2], rows[:, 2:4] - rows[:, :2]]), rows[:, 4], rows[:, 5]
    if head == "yolo":
        output = output.T
    first = 5 if head == "yolox" else 4
    scores = output[:, first:]
    if head == "yolox":
        scores = scores * output[:, 4:5]
    best = scores.max(1)
    chosen = best >= CONFIDENCE
    boxes = output[chosen, :4]
    scores = scores[chosen]
    best = best[chosen]
    centres = boxes[:, :2]
    sides = boxes[:, 2:]
    if head == "yolox":
        stride = grid[chosen, 2:]
        centres = (centres + grid[chosen, :2]) * stride
        sides = numpy.exp(sides) * stride
    boxes = numpy.hstack([centres - sides / 2, sides])
    return boxes, best, scores.argmax(1)


def main(model, folder, head, threads):
    if head not in ("yolox", "yolo", "end-to-end"):
        sys.exit(f"python_path.py does not read the head {head}")
    threads = int(threads)
    cv2.setNumThreads(threads)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    given = session.get_inputs()[0]
    rows, columns = given.shape[2:]
    grid = yolox_grid(rows, columns) if head == "yolox" else None
    files = [path.read_bytes() for path in sorted(pathlib.Path(folder).iterdir())]

    def frame(data, times):
        moments = [time.perf_counter()]
        picture = cv2.imdecode(numpy.frombuffer(data, numpy.uint8), cv2.IMREAD_COLOR)
        moments.append(time.perf_counter())
        tensor, scale, left, top = letterbox(picture, rows, columns, head)
        moments.append(time.perf_counter())
        output = session.run(None, {given.name: tensor})[0][0]
        moments.append(time.perf_counter())
        boxes, scores, classes = read(output, head, grid)
        if head != "end-to-end" and len(boxes):
            kept = cv2.dnn.NMSBoxesBatched(boxes, scores, classes, CONFIDENCE, OVERLAP)
            boxes, scores, classes = boxes[kept], scores[kept], classes[kept]
        boxes = (boxes - [left, top, 0, 0]) / scale
        moments.append(time.perf_counter())
        for stage, start, end in zip(times, moments, moments[1:]):
            times[stage].append((end - start) * 1e3)
        return len(boxes)

    def stages():
        return {"decode": [], "letterbox": [], "model": [], "head": []}

    frame(files[0], stages())
    versions = f"OpenCV {cv2.__version__}, NumPy {numpy.__version__}, ONNX Runtime {onnxruntime.__version__}"
    print(versions, flush=True)
    for _ in sys.stdin:
        times = stages()
        detections = 0
        for data in files:
            detections += frame(data, times)
        print(json.dumps({**times, "detections": detections}), flush=True)


main(*sys.argv[1:])
