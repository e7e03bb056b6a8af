"""Checks that boxes come out in the type in which results go in."""

import json
import pathlib
import unittest
import warnings

import numpy as np

from albireo import Boxes, Skipper
from albireo.results import read

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import supervision

SIZE = (640, 480)
XYXY = np.array([[10.0, 20, 110, 220], [300, 40, 380, 90]])


class Arrays(unittest.TestCase):
    def test_rows_are_returned_with_ids_before_the_confidence(self):
        rows = np.array([[*XYXY[0], 0.9, 2], [*XYXY[1], 0.8, 7]], np.float32)
        skip = Skipper("fixed-skip-in-tracker", threshold=2, size=SIZE)
        for n in range(4):
            shown = skip.update(rows) if skip.wants_detector(n) else skip.predict()
            self.assertEqual((shown.shape, shown.dtype), ((2, 7), np.float32))
            np.testing.assert_allclose(shown[:, :4], XYXY, atol=1)
            self.assertEqual(shown[:, 4].tolist(), [0, 1])
            self.assertEqual(shown[:, 6].tolist(), [2, 7])
        for shape in [(2, 4), (6,), (1, 2, 6)]:
            with self.assertRaisesRegex(ValueError, r"must be \(N, 6\): x1, y1, x2, y2, confidence, class"):
                Skipper(size=SIZE).update(np.zeros(shape))

    def test_rows_in_half_precision_are_returned_with_ids_that_differ(self):
        rows = np.array([[*XYXY[0], 0.9, 2], [*XYXY[1], 0.8, 7]], np.float16)
        on_device = Results(np.zeros((480, 640, 3), np.uint8), "", {}, Tensor(rows))
        in_memory = Results(np.zeros((480, 640, 3), np.uint8), "", {}, rows)
        columns = np.array([0.9, 0.8]), np.array([2, 7]), np.array([2048, 2049]), np.array(["detected"] * 2)
        for result in (rows, on_device, in_memory):
            _, restore = read(result, SIZE, {})
            shown = restore(Boxes(XYXY, *columns), None)
            shown = shown if result is rows else shown.boxes.data
            shown = shown.cpu().numpy() if isinstance(shown, Tensor) else shown
            self.assertEqual((shown.dtype, shown[:, 4].tolist()), (np.float32, [2048, 2049]))

    def test_boxes_that_are_hardly_in_pixels_are_reported_once(self):
        for xyxy, said in [
            (XYXY / 640, "no box reaches beyond the first pixel; these look like shares"),
            (XYXY + 2000, "all boxes lie outside the picture of 640x480 pixels"),
        ]:
            skip = Skipper("vanilla", size=SIZE)
            with warnings.catch_warnings(record=True) as reported:
                warnings.simplefilter("always")
                for n in range(3):
                    skip.wants_detector(n)
                    skip.update((xyxy, [0.9, 0.8], [1, 2]))
            self.assertEqual([str(one.message)[: len(said)] for one in reported], [said])
            self.assertEqual(reported[0].filename, __file__)

    def test_boxes_that_reach_out_of_the_picture_and_filled_up_rows_are_not_reported(self):
        for xyxy in (XYXY - 60, XYXY * 0, XYXY * np.nan, XYXY[:, [2, 3, 0, 1]]):
            skip = Skipper("vanilla", size=SIZE)
            skip.wants_detector(0)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                skip.update((xyxy, [0.9, 0.8], [1, 2]))

    def test_boxes_keep_their_precision(self):
        for dtype in (np.float32, np.float64):
            skip = Skipper(size=SIZE)
            skip.wants_detector(0)
            boxes = skip.update((XYXY.astype(dtype), np.array([0.9, 0.8], dtype), np.array([1, 2])))
            self.assertEqual((boxes.xyxy.dtype, boxes.confidence.dtype), (dtype, dtype))
            np.testing.assert_allclose(boxes.xyxy, XYXY)
            if skip.wants_detector(1):
                skip.unavailable()
            self.assertEqual(skip.predict().xyxy.dtype, dtype)

    def test_returned_boxes_are_accepted_as_a_result(self):
        one = Skipper(size=SIZE)
        two = Skipper(size=SIZE)
        one.wants_detector(0)
        two.wants_detector(0)
        boxes = one.update((XYXY, np.array([0.9, 0.8]), np.array([1, 2])))
        np.testing.assert_array_equal(two.update(boxes).xyxy, boxes.xyxy)

    def test_boxes_are_a_sequence_of_boxes(self):
        skip = Skipper(size=SIZE)
        skip.wants_detector(0)
        boxes = skip.update((XYXY, np.array([0.9, 0.8]), np.array([1, 2])))
        first, second = boxes
        self.assertEqual((len(boxes), boxes[1], boxes[-1]), (2, second, second))
        self.assertEqual([box.class_id for box in boxes], [1, 2])
        np.testing.assert_allclose([box.xyxy for box in boxes], XYXY)
        self.assertEqual(first[1:], (boxes.confidence[0], 1, 0, "detected"))
        self.assertEqual([type(value) for value in first], [tuple, float, int, int, str])
        for which in (boxes.class_id == 2, slice(1, 2), [1], np.array([1])):
            self.assertIsInstance(boxes[which], Boxes)
            self.assertEqual(list(boxes[which]), [second])
        with self.assertRaises(IndexError):
            boxes[2]
        nothing = boxes[:0]
        self.assertEqual(list(nothing), [])
        if skip.wants_detector(1):
            skip.update(nothing)

    def test_invalid_results_are_rejected_with_the_reason(self):
        skip = Skipper(size=SIZE)
        skip.wants_detector(0)
        for result, kind, said in [
            (None, TypeError, "NoneType"),
            (XYXY, ValueError, r"shape \(2, 4\); it must be \(N, 6\)"),
            ([1], TypeError, "a list with one result for each picture"),
            ((XYXY,), ValueError, "length 1"),
            ((XYXY, [0.9], [1, 2]), ValueError, r"\(2, 4\), 1 confidences and 2 classes"),
            ((XYXY[0], [0.9], [1]), ValueError, r"shape \(4,\); they must be \(N, 4\)"),
            ((XYXY, [0.9, 0.8], [1, 2.5]), ValueError, "a class is 2.5"),
            ((XYXY, [0.9, 0.8], [1, -1]), ValueError, "a class is -1"),
            ((XYXY, [0.9, 0.8], ["car", "bus"]), TypeError, "class_id must be real numbers"),
            ((XYXY * 1j, [0.9, 0.8], [1, 2]), TypeError, "complex128"),
        ]:
            with self.subTest(said), self.assertRaisesRegex(kind, said):
                skip.update(result)
        self.assertEqual(len(skip.update((XYXY, [0.9, 0.8], [1, 2])).xyxy), 2)


class Supervision(unittest.TestCase):
    def detections(self, shift=0.0):
        return supervision.Detections(
            xyxy=(XYXY + [shift, 0, shift, 0]).astype(np.float32),
            confidence=np.array([0.9, 0.8], np.float32),
            class_id=np.array([2, 7]),
            data={"class_name": np.array(["car", "truck"])},
        )

    def test_detections_are_returned_as_detections(self):
        skip = Skipper("expected-loss", size=SIZE)
        kinds = set()
        for n in range(40):
            boxes = skip.update(self.detections(n)) if skip.wants_detector(n) else skip.predict()
            self.assertIsInstance(boxes, supervision.Detections)
            self.assertEqual(boxes.xyxy.dtype, np.float32)
            self.assertEqual(boxes.tracker_id.tolist(), [0, 1])
            self.assertEqual(boxes["class_name"].tolist(), ["car", "truck"])
            kinds |= set(boxes["source"])
            # supervision filters its detections like this.
            self.assertEqual(len(boxes[boxes.class_id == 2]), 1)
        self.assertEqual(kinds, {"detected", "predicted"})

    def test_an_empty_frame_and_missing_columns_are_accepted(self):
        skip = Skipper("vanilla", size=SIZE)
        skip.wants_detector(0)
        self.assertEqual(len(skip.update(supervision.Detections.empty())), 0)
        skip.wants_detector(1)
        boxes = skip.update(supervision.Detections(xyxy=XYXY))
        self.assertEqual((boxes.confidence.tolist(), boxes.class_id.tolist()), ([1.0, 1.0], [0, 0]))


class Tensor:
    """The part of torch.Tensor that the package uses."""

    def __init__(self, array, device="cuda:0"):
        self.array, self.device = np.asarray(array), device

    def __array__(self, *_):
        raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu() first")

    def __getitem__(self, key):
        return Tensor(self.array[key], self.device)

    def detach(self):
        return self

    def cpu(self):
        return Tensor(self.array, "cpu")

    def numpy(self):
        if self.device != "cpu":
            raise TypeError("can't convert cuda:0 device type tensor to numpy")
        return self.array

    def float(self):
        return Tensor(self.array.astype(np.float32), self.device)

    def new_tensor(self, array):
        return Tensor(np.asarray(array, self.array.dtype), self.device)


class ResultBoxes:
    """The layout of ultralytics.engine.results.Boxes of version 8: rows of x1, y1, x2, y2, (id,) confidence, class."""

    def __init__(self, data, orig_shape):
        columns = (data.array if isinstance(data, Tensor) else data).shape[-1]
        assert columns in (6, 7), f"expected 6 or 7 values but got {columns}"
        self.data, self.orig_shape, self.is_track = data, orig_shape, columns == 7

    xyxy = property(lambda self: self.data[:, :4])
    conf = property(lambda self: self.data[:, -2])
    cls = property(lambda self: self.data[:, -1])
    id = property(lambda self: self.data[:, -3] if self.is_track else None)


class Results:
    """The layout of ultralytics.engine.results.Results of version 8."""

    def __init__(self, orig_img, path, names, boxes=None):
        self.orig_img, self.orig_shape = orig_img, orig_img.shape[:2]
        self.boxes = ResultBoxes(boxes, self.orig_shape) if boxes is not None else None
        self.names, self.path = names, path

    def new(self):
        return Results(self.orig_img, self.path, self.names)

    def update(self, boxes=None):
        self.boxes = ResultBoxes(boxes, self.orig_shape)


class Ultralytics(unittest.TestCase):
    # The detections of an Ultralytics network. `make parity` records them and runs this loop with Ultralytics itself.
    FOUND = json.loads((pathlib.Path(__file__).parent / "ultralytics.json").read_text())
    ROWS = np.array(FOUND["rows"], np.float32)
    NAMES = {int(number): name for number, name in FOUND["names"].items()}

    def results(self, on_device=False):
        data = Tensor(self.ROWS) if on_device else self.ROWS.copy()
        return Results(np.zeros((*self.FOUND["orig_shape"], 3), np.uint8), "busy.jpg", self.NAMES, data)

    def test_results_are_returned_as_results_with_ids(self):
        for on_device in (False, True):
            with self.subTest(on_device=on_device):
                height, width = self.FOUND["orig_shape"]
                skip = Skipper("fixed-skip-in-tracker", threshold=2, size=(width, height))
                for n in range(4):
                    image = np.full((height, width, 3), n, np.uint8)
                    shown = skip.update(self.results(on_device)) if skip.wants_detector(n) else skip.predict(image)
                    self.assertIsInstance(shown, Results)
                    boxes = shown.boxes
                    array = (lambda tensor: tensor.cpu().numpy()) if on_device else np.asarray
                    self.assertEqual(isinstance(boxes.data, Tensor), on_device)
                    self.assertEqual(array(boxes.data).dtype, np.float32)
                    self.assertEqual(array(boxes.id).tolist(), list(range(len(self.ROWS))))
                    self.assertEqual(array(boxes.cls).tolist(), self.ROWS[:, 5].tolist())
                    np.testing.assert_allclose(array(boxes.xyxy), self.ROWS[:, :4], atol=1)
                    self.assertEqual(shown.names, self.NAMES)
                    self.assertEqual(shown.source[0], "predicted" if n % 2 else "detected")
                    self.assertEqual(shown.orig_img[0, 0, 0], n if n % 2 else 0)

    def test_a_result_of_another_size_or_without_boxes_is_rejected(self):
        skip = Skipper(size=(1280, 720))
        skip.wants_detector(0)
        with self.assertRaisesRegex(ValueError, "640x360 pixels; this skipper takes 1280x720"):
            skip.update(self.results())
        with self.assertRaisesRegex(TypeError, "has no boxes"):
            skip.update(self.results().new())


if __name__ == "__main__":
    unittest.main()
