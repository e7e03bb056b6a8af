"""What a type checker knows of calls: it is run on this file, which is never executed.

An `ignore` that is not needed is an error, so that what is wrong must be found.
"""

from typing import Any

import numpy as np
import supervision as sv
from numpy.typing import NDArray
from typing_extensions import assert_type

import albireo
from albireo import Box, Boxes, Skipper, Tracked, Tracking

arrays = (np.zeros((0, 4)), np.zeros(0), np.zeros(0, int))
found = sv.Detections.empty()

# `update` returns the type that it takes.
skip = Skipper(size=(640, 480))
assert_type(skip.update(arrays), Boxes)
assert_type(skip.update(([[1.0, 2, 3, 4]], [0.9], [1])), Boxes)
assert_type(skip.update(skip.update(arrays)), Boxes)
assert_type(skip.update(np.zeros((0, 6))), NDArray[Any])
assert_type(skip.update(found), sv.Detections)
assert_type(skip.deliver(3, found), sv.Detections)
skip.audit(found)
skip.update(None)  # type: ignore[call-overload]
skip.update("yolo")  # type: ignore[call-overload]

# What the others return is known to a skipper of a type.
own = Skipper[sv.Detections]("albireo", size=(640, 480))
assert_type(own.predict(), sv.Detections)
assert_type(own.unavailable(), sv.Detections)
assert_type(own.deliver(3, None), sv.Detections)
assert_type(own.settled(), list[tuple[int, sv.Detections]])

boxes = skip.update(arrays)
assert_type(boxes[0], Box)
assert_type(boxes[1:], Boxes)
assert_type([box.xyxy for box in boxes], list[tuple[float, float, float, float]])

picture = np.zeros((480, 640, 3), np.uint8)
skip.look(picture, color_order="bgr")
skip.look(picture, color_order="gbr")  # type: ignore[arg-type]


def to_columns(image: albireo.Image) -> albireo.Columns:
    return arrays


def to_detections(image: albireo.Image) -> sv.Detections:
    return found


def to_list(image: albireo.Image) -> list[sv.Detections]:
    return [found]


assert_type(albireo.track("drive.mp4", to_detections), Tracking[sv.Detections])
assert_type(albireo.track([picture], to_list), Tracking[sv.Detections])
tracked = albireo.track(0, to_columns, "albireo", threshold=0.1, color_order="rgb", progress=True)
assert_type(tracked.skipper.predict(), Boxes)
for frame in tracked:
    assert_type(frame, Tracked[Boxes])
    assert_type(frame.detected, bool)
albireo.track(to_columns, "drive.mp4")  # type: ignore[call-overload]
