"""Computes the average precision of boxes with pycocotools.

Reads JSON from standard input:
  {"clips": [[{"predictions": [[x1, y1, x2, y2, class, confidence], ...],
               "truth": [[x1, y1, x2, y2, class, confidence], ...],
               "ignored": [[x1, y1, x2, y2, class, "crowd" or "object"], ...]}, ...], ...]}
Writes JSON: for each clip and definition, AP@50 and the mean over IoU 0.50 to 0.95.

COCO samples precision at 101 recall levels. The area over all points is the mean of the interpolated
precision at the recalls 1/n, 2/n, ... n/n with n the number of ground-truth boxes, so asking pycocotools
for these levels gives the all-point definition.
"""

import contextlib
import io
import json
import sys

import numpy
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

IOU_THRESHOLDS = numpy.array([0.50, 0.55, 0.60, 0.65, 0.70, 0.75, 0.80, 0.85, 0.90, 0.95])


def box(corners):
    x1, y1, x2, y2 = corners
    return [x1, y1, x2 - x1, y2 - y1]


# An object of this area is outside the range that is judged, and so it is ignored without being a crowd.
TOO_LARGE = 1e11


def build(frames):
    truth, predictions, classes = [], [], set()
    for image, frame in enumerate(frames, start=1):
        for *corners, category, kind in frame["truth"] + frame["ignored"]:
            x, y, width, height = box(corners)
            truth.append(
                {
                    "id": len(truth) + 1,
                    "image_id": image,
                    "category_id": category,
                    "bbox": [x, y, width, height],
                    "area": TOO_LARGE if kind == "object" else width * height,
                    "iscrowd": int(kind == "crowd"),
                }
            )
            classes.add(category)
        for *corners, category, confidence in frame["predictions"]:
            predictions.append(
                {"image_id": image, "category_id": category, "bbox": box(corners), "score": confidence}
            )
            classes.add(category)
    coco = COCO()
    coco.dataset = {
        "info": {},
        "images": [{"id": image} for image in range(1, len(frames) + 1)],
        "annotations": truth,
        "categories": [{"id": category, "name": str(category)} for category in sorted(classes)],
    }
    coco.createIndex()
    return coco, coco.loadRes(predictions), sum(len(frame["truth"]) for frame in frames)


def evaluate(coco, found, pooled, recalls):
    judge = COCOeval(coco, found, "bbox")
    judge.params.useCats = 0 if pooled else 1
    judge.params.iouThrs = IOU_THRESHOLDS
    judge.params.recThrs = recalls
    judge.params.maxDets = [1_000_000]
    judge.params.areaRng = [[0, 1e10]]
    judge.params.areaRngLbl = ["all"]
    judge.evaluate()
    judge.accumulate()
    # Axes: threshold, recall, class, area, number of detections; -1 marks a class without ground truth.
    precision = judge.eval["precision"][:, :, :, 0, 0]
    present = precision[0, 0, :] > -1
    by_threshold = precision[:, :, present].mean(axis=(1, 2))
    return {"ap50": by_threshold[0], "map": by_threshold.mean()}


def judge(frames):
    coco, found, truths = build(frames)
    all_points = numpy.arange(1, truths + 1) / truths
    levels = numpy.linspace(0.0, 1.0, 101)
    return {
        "pooled_all_points": evaluate(coco, found, True, all_points),
        "pooled_101": evaluate(coco, found, True, levels),
        "separate_101": evaluate(coco, found, False, levels),
    }


def main():
    clips = json.load(sys.stdin)["clips"]
    with contextlib.redirect_stdout(io.StringIO()):
        results = [judge(frames) for frames in clips]
    json.dump(results, sys.stdout)


main()
