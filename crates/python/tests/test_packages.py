"""Runs what the wheel's README and the notebook show, with the packages that they are for, on a real road.

OpenCV and supervision are the real ones. Ultralytics and PyTorch are too large to install here (6 GB): stand-ins have their
layout, and the boxes of YOLOX-Nano.
"""

import contextlib
import io
import json
import pathlib
import re
import sys
import tarfile
import tempfile
import types
import unittest
import warnings
from unittest import mock

import cv2
import numpy as np

import albireo
from test_results import Results, Tensor, supervision

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path.append(str(ROOT / "docs/examples"))

from yolox import Yolox  # noqa: E402

FRAMES = 60
README = (ROOT / "crates/python/README.md").read_text()
BLOCKS = dict(re.findall(r"^#+ ([\w]+)[^#]*?```python\n(.*?)```", README, re.S | re.M))
YOLOX = Yolox(str(ROOT / "models/yolox_nano.onnx"))


def detector(image):
    """YOLOX-Nano on a BGR picture."""
    return YOLOX(np.ascontiguousarray(image[..., ::-1]))


class Torch(Tensor):
    """A little more of torch.Tensor, for the README."""

    def permute(self, *axes):
        return Torch(self.array.transpose(axes), self.device)

    def __truediv__(self, number):
        return Torch(self.array / number, self.device)

    def int(self):
        return Torch(self.array.astype(int), self.device)

    def tolist(self):
        return self.array.tolist()

    def __getitem__(self, key):
        return Torch(self.array[key], self.device)

    def new_tensor(self, array):
        return Torch(np.asarray(array, self.array.dtype), self.device)


class Yolo:
    """The layout of ultralytics.YOLO: called with a BGR picture, it returns a list with one result."""

    def __init__(self, file):
        self.names = {n: str(n) for n in range(80)}

    def __call__(self, image):
        data = Torch(np.column_stack(detector(image)).astype(np.float32))
        return [Results(image, "", self.names, data)]


class Network:
    """The layout of torchvision's detectors: called with RGB pictures of shape (3, rows, columns) from 0 to 1."""

    def eval(self):
        return self

    def __call__(self, pictures):
        image = np.rint(255 * pictures[0].array).astype(np.uint8).transpose(1, 2, 0)
        boxes, scores, labels = map(Torch, YOLOX(image))
        return [{"boxes": boxes, "scores": scores, "labels": labels}]


TORCH = types.SimpleNamespace(inference_mode=lambda: lambda function: function, from_numpy=lambda array: Torch(array, "cpu"))
TORCHVISION = types.SimpleNamespace(models=types.SimpleNamespace(detection=types.SimpleNamespace(
    fasterrcnn_mobilenet_v3_large_320_fpn=lambda weights: Network())))


class Road(unittest.TestCase):
    """A folder with `drive.mp4`, the first frames of a real road."""

    @classmethod
    def setUpClass(cls):
        folder = cls.enterClassContext(tempfile.TemporaryDirectory())
        cls.enterClassContext(contextlib.chdir(folder))
        with tarfile.open(ROOT / "demo/road.tar") as road:
            names = sorted(name for name in road.getnames() if name.startswith("busy/") and name.endswith(".jpg"))
            cls.pictures = [
                cv2.imdecode(np.frombuffer(road.extractfile(name).read(), np.uint8), cv2.IMREAD_COLOR) for name in names[:FRAMES]
            ]
        # A format with the index in front would be cut differently; MPEG in AVI is readable up to the cut.
        cls.write("drive.mp4", "mp4v")
        cls.write("drive.avi", "MJPG")

    @classmethod
    def write(cls, name, codec):
        rows, columns, _ = cls.pictures[0].shape
        video = cv2.VideoWriter(name, cv2.VideoWriter.fourcc(*codec), 25, (columns, rows))
        for picture in cls.pictures:
            video.write(picture)
        video.release()


class Readme(Road):
    def run_block(self, name, **known):
        names = {"detector": detector, **known}
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
            exec(compile(BLOCKS[name], f"README, {name}", "exec"), names)
        return names, said.getvalue()

    def assert_skips(self, skip, said=None):
        self.assertEqual(skip.frames, FRAMES)
        self.assertTrue(0.3 < skip.skipped < 0.9, skip)
        if said is not None:
            self.assertIn("frames skipped", said)

    def test_the_readme_has_these_blocks(self):
        self.assertEqual(list(BLOCKS), ["albireo", "OpenCV", "supervision", "Ultralytics", "PyTorch"])
        self.assertEqual(README.count("```python"), len(BLOCKS))

    def test_the_first_block_prints_boxes_and_a_summary(self):
        names, said = self.run_block("albireo")
        self.assert_skips(names["tracked"].skipper, said)
        self.assertGreater(len(said.splitlines()), FRAMES)
        sources = {line.split()[-1] for line in said.splitlines() if line[0].isdigit()}
        self.assertLess({"detected", "predicted"}, sources | {"rescued"})

    def test_opencv_reads_draws_and_writes(self):
        names, said = self.run_block("OpenCV")
        self.assert_skips(names["skip"], said)
        self.assertEqual(len(list(albireo.track("tracked.mp4", lambda image: np.zeros((0, 6))))), FRAMES)

    def test_supervision_annotates_detected_and_predicted_boxes(self):
        # supervision moves its own names, and says so.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            names, said = self.run_block("supervision", detector=lambda image: supervision.Detections(
                **dict(zip(("xyxy", "confidence", "class_id"), detector(image)))))
        self.assertIsInstance(names["frame"].boxes, supervision.Detections)
        self.assertIn("cars at the end", said)
        self.assertEqual(len(list(albireo.track("traced.mp4", lambda image: np.zeros((0, 6))))), FRAMES)

    def test_ultralytics_results_have_ids_on_every_frame(self):
        with mock.patch.dict(sys.modules, ultralytics=types.SimpleNamespace(YOLO=Yolo)):
            names, said = self.run_block("Ultralytics")
        self.assert_skips(names["tracked"].skipper, said)
        self.assertEqual(said.count(" predicted ") + said.count(" detected "), FRAMES)
        self.assertIs(type(names["frame"].boxes), Results)

    def test_pytorch_takes_rgb_and_gives_tensors(self):
        with mock.patch.dict(sys.modules, torch=TORCH, torchvision=TORCHVISION):
            names, said = self.run_block("PyTorch")
        self.assert_skips(names["tracked"].skipper, said)
        self.assertIn(f"{len(names['seen'])} objects", said)
        self.assertGreater(len(names["seen"]), 3)


class Notebook(unittest.TestCase):
    def test_the_cells_of_the_notebook_run_and_were_run(self):
        cells = json.loads((ROOT / "docs/python.ipynb").read_text())["cells"]
        cells = [cell for cell in cells if cell["cell_type"] == "code"]
        names, said = {}, io.StringIO()
        with contextlib.chdir(ROOT / "docs"), contextlib.redirect_stdout(said), mock.patch.dict("os.environ", MPLBACKEND="Agg"):
            for number, cell in enumerate(cells, 1):
                with warnings.catch_warnings():
                    warnings.filterwarnings("ignore", "FigureCanvasAgg is non-interactive")
                    exec(compile("".join(cell["source"]), f"docs/python.ipynb, cell {number}", "exec"), names)
                self.assertEqual(cell["execution_count"], number)
        names["folder"].cleanup()
        self.assertRegex(said.getvalue(), r"1[0-6]\d of 221 frames skipped")
        # The figures that the page shows are those of this version, but for what another processor rounds otherwise.
        printed = "".join(line for cell in cells for output in cell["outputs"] for line in output.get("text", []))
        numbers = [[float(number) for number in re.findall(r"\d+\.?\d*", text)] for text in (said.getvalue(), printed)]
        np.testing.assert_allclose(*numbers, atol=3)


class Video(Road):
    def test_a_detector_gets_the_colors_that_it_asks_for(self):
        seen = {}
        for order in ("bgr", "rgb"):
            frame = next(albireo.track("drive.avi", lambda image: seen.setdefault(order, image) is None or np.zeros((0, 6)),
                                       color_order=order))
            self.assertIs(frame.image, seen[order])
            # PyTorch takes no array with steps backwards.
            self.assertTrue(frame.image.flags.c_contiguous)
        np.testing.assert_array_equal(seen["rgb"], seen["bgr"][..., ::-1])
        self.assertLess(np.abs(seen["bgr"].astype(int) - self.pictures[0]).mean(), 3)

    def test_predicted_results_show_a_bgr_picture_whatever_the_detector_takes(self):
        yolo = Yolo("")
        for frame in albireo.track(self.pictures, yolo, "fixed-skip-in-tracker", threshold=2):
            self.assertIs(frame.boxes.orig_img, frame.image)
        turned = [np.ascontiguousarray(picture[..., ::-1]) for picture in self.pictures[:6]]
        for frame in albireo.track(turned, lambda image: yolo(image[..., ::-1]), "fixed-skip-in-tracker", threshold=2, color_order="rgb"):
            np.testing.assert_array_equal(frame.boxes.orig_img, self.pictures[frame.number])

    def test_a_video_that_ends_early_is_reported(self):
        whole = pathlib.Path("drive.avi").read_bytes()
        pathlib.Path("cut.avi").write_bytes(whole[: len(whole) // 2])
        with self.assertWarnsRegex(UserWarning, rf"'cut.avi' has {FRAMES} frames and OpenCV could read \d+: the file may be cut"):
            frames = list(albireo.track("cut.avi", lambda image: np.zeros((0, 6))))
        self.assertTrue(10 < len(frames) < 50, len(frames))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            self.assertEqual(len(list(albireo.track("drive.avi", lambda image: np.zeros((0, 6))))), FRAMES)

    def test_a_file_that_is_no_video_is_an_error_of_the_call(self):
        pathlib.Path("notes.mp4").write_text("no video")
        for name in ("notes.mp4", "missing.mp4", pathlib.Path("missing.mp4")):
            with self.assertRaisesRegex(FileNotFoundError, "OpenCV cannot open '.*mp4' as a video"):
                albireo.track(name, detector)

    def test_an_audit_runs_the_detector_on_some_skipped_frames_and_changes_no_box(self):
        plain, audited = (albireo.track("drive.avi", detector, audit=share, seed=1) for share in (0.0, 0.5))
        for one, two in zip(plain, audited, strict=True):
            np.testing.assert_array_equal(one.boxes.xyxy, two.boxes.xyxy)
        self.assertNotIn("audit", str(plain))
        self.assertRegex(str(audited), r"audit: \d+\.\d% \[.*\] of what the detector sees had been shown")

    def test_a_progress_bar_counts_the_frames_and_says_what_is_skipped(self):
        for video in ("drive.avi", self.pictures):
            said = io.StringIO()
            with contextlib.redirect_stderr(said):
                list(albireo.track(video, detector, progress=True))
            self.assertRegex(said.getvalue(), rf"100%.*{FRAMES}/{FRAMES} .*frames.*, \d+% skipped")
        said = io.StringIO()
        with contextlib.redirect_stderr(said):
            list(albireo.track(self.pictures, detector))  # the error output is no terminal
        self.assertEqual(said.getvalue(), "")


if __name__ == "__main__":
    unittest.main()
