"""Tests the loop: order of calls, lost frames, ids, totals, audit, pickle."""

import doctest
import pickle
import sys
import unittest
from unittest import mock

import numpy as np

import albireo
import albireo.skipper
from albireo import Skipper

SIZE = (1280, 720)


def found(n, objects=3):
    """The detections of objects that move to the right, each at a different height."""
    left = 100.0 + 3 * n
    xyxy = np.array([[left, 50 + 150 * i, left + 80, 140 + 150 * i] for i in range(objects)]).reshape(-1, 4)
    return xyxy, np.linspace(0.9, 0.6, objects), np.arange(objects) % 3


def step(skip, n, model=found):
    return skip.update(model(n)) if skip.wants_detector(n) else skip.predict()


class Loop(unittest.TestCase):
    def test_the_documentation_examples_run(self):
        self.assertEqual(doctest.testmod(albireo.skipper).failed, 0)
        self.assertGreater(doctest.testmod(albireo.skipper).attempted, 5)

    def test_ids_are_stable_and_boxes_follow_the_objects(self):
        skip = Skipper("expected-loss", threshold=0.3, size=SIZE)
        for n in range(120):
            boxes = step(skip, n)
            self.assertEqual(boxes.tracker_id.tolist(), [0, 1, 2])
            if n > 20:
                np.testing.assert_allclose(boxes.xyxy, found(n)[0], atol=3)
            expected = "predicted" if skip.state == "P" else "detected"
            self.assertEqual(set(boxes.source), {expected})
        self.assertGreater(skip.skipped, 0.5)
        self.assertEqual(skip.frames, 120)
        self.assertEqual(sum(skip.causes.values()), skip.calls)

    def test_objects_keep_moving_across_lost_frames(self):
        skip = Skipper("expected-loss", threshold=2.0, size=SIZE)
        for n in range(60):
            step(skip, n)
        # Three frames are lost, and then those on which the detector fails.
        n = 63
        while skip.wants_detector(n):
            skip.unavailable()
            n += 1
        np.testing.assert_allclose(skip.predict().xyxy, found(n)[0], atol=5)

    def test_a_higher_threshold_skips_more_frames(self):
        shares = []
        for threshold in (0.1, 1.0):
            skip = Skipper("expected-loss", size=SIZE)
            skip.threshold = threshold
            for n in range(100):
                step(skip, n)
            shares.append(skip.skipped)
        self.assertLess(shares[0], shares[1])

    def test_a_failed_call_gives_predictions_and_is_retried(self):
        skip = Skipper("albireo", size=SIZE)
        n = 0
        while not (skip.wants_detector(n) and n > 5):
            if skip._core.wants:
                skip.update(found(n))
            n += 1
        boxes = skip.unavailable()
        self.assertEqual(set(boxes.source), {"predicted"})
        self.assertTrue(skip.wants_detector(n + 1))
        self.assertIn("1 calls failed", str(skip))

    def test_a_call_out_of_order_is_an_error_that_explains_the_order(self):
        skip = Skipper(size=SIZE)
        for call in (skip.predict, skip.unavailable, lambda: skip.update(found(0))):
            with self.assertRaisesRegex(RuntimeError, r"wants_detector\(n\)"):
                call()
        self.assertTrue(skip.wants_detector(7))
        with self.assertRaisesRegex(RuntimeError, r"frame 7 wants the detector: call update\(result\)"):
            skip.predict()
        skip.update(found(7))
        with self.assertRaisesRegex(RuntimeError, "frame 7 does not want the detector"):
            skip.update(found(7))
        with self.assertRaisesRegex(ValueError, "frame 7 cannot follow frame 7"):
            skip.wants_detector(7)
        skip.reset()
        self.assertTrue(skip.wants_detector(0))

    def test_a_frame_without_a_result_counts_as_lost(self):
        skip = Skipper(size=SIZE)
        self.assertTrue(skip.wants_detector(0))
        self.assertTrue(skip.wants_detector(1))
        skip.update(found(1))
        self.assertEqual(skip.frames, 1)
        self.assertIn("1 frames were left without a result", str(skip))

    def test_invalid_settings_are_rejected_with_a_reason(self):
        for settings, said in [
            ({"policy": "yolo"}, "there is no policy `yolo`; the policies are `albireo`"),
            ({"threshold": float("nan")}, "`lambda` must be a number from"),
            ({"policy": "vanilla", "threshold": 0.5}, "no threshold to change"),
            ({"profile": "paperr"}, "'paper' and 'reference'"),
            ({"size": (0, 720)}, "1 to 65535 pixels"),
            ({"size": 1280}, r"\(width, height\)"),
            ({"audit": 2}, "from 0 to 1"),
            ({"seed": -1}, "seed"),
        ]:
            with self.subTest(settings), self.assertRaisesRegex(ValueError, said):
                Skipper(**({"size": SIZE} | settings))

    def test_the_summary_has_the_skip_rate_and_the_causes_of_calls(self):
        skip = Skipper("fixed-skip", threshold=4, size=SIZE)
        for n in range(40):
            step(skip, n)
        said = str(skip)
        self.assertIn("30 of 40 frames skipped (75%), 10 detector calls", said)
        self.assertIn("10 because schedule", said)

    def test_a_custom_check_for_empty_scenes_saves_a_call(self):
        skip = Skipper("albireo", size=SIZE)
        self.assertFalse(skip.wants_detector(0, empty=True))
        self.assertEqual((skip.state, len(skip.predict().xyxy)), ("E", 0))
        self.assertTrue(skip.wants_detector(1, empty=False))
        skip.update(found(1))
        self.assertEqual((skip.state, skip.cause), ("E+I", "screen"))

    def test_an_audit_samples_skipped_frames_and_reports_recall(self):
        skip = Skipper(size=SIZE, audit=0.5, seed=3)
        drawn = 0
        for n in range(200):
            wanted = skip.wants_detector(n)
            if wanted:
                skip.update(found(n))
            if skip.audit_due(n):
                self.assertFalse(wanted)
                before = skip.predict()
                skip.audit(found(n))
                np.testing.assert_array_equal(skip.predict().xyxy, before.xyxy)
                drawn += 1
        self.assertTrue(0.3 < drawn / (200 - skip.calls) < 0.7, drawn)
        self.assertGreater(skip.recall[0], 0.95)
        self.assertIn("of what the detector sees had been shown", str(skip))

    def test_flow_follows_an_object_that_stops(self):
        """A textured square stops. With flow its box stops too, without flow it moves on."""
        texture = np.random.default_rng(1).integers(0, 255, (60, 60), dtype=np.uint8)
        texture = texture.repeat(2, 0).repeat(2, 1)
        ends = {}
        for policy in ("even-skip-in-tracker", "even-skip-in-tracker+flow"):
            skip = Skipper(policy, threshold=0.9, size=(640, 360))
            sources = set()
            for n in range(70):
                left = 40 + 4 * min(n, 61)
                image = np.full((360, 640), 90, np.uint8)
                image[100:220, left : left + 120] = texture
                skip.look(image)
                at = np.array([[left, 100.0, left + 120, 220]]), np.array([0.9]), np.array([1])
                boxes = skip.update(at) if skip.wants_detector(n) else skip.predict()
                sources |= set(boxes.source)
            ends[policy] = abs(boxes.xyxy[0, 0] - left)
            self.assertEqual("followed" in sources, policy.endswith("flow"))
        blind, seeing = ends.values()
        self.assertLess(seeing, 2)
        self.assertGreater(blind, 2 * seeing)


class Pickle(unittest.TestCase):
    def test_a_pickled_skipper_continues_identically(self):
        for policy in ("expected-loss", "albireo", "fixed-skip", "ctd", "vanilla"):
            with self.subTest(policy):
                one = Skipper(policy, size=SIZE, resumable=True)
                for n in range(50):
                    if n == 20 and one.threshold is not None:
                        one.threshold = one.threshold * 1.5
                    if n == 30:
                        one.reset()
                    if n == 37:
                        continue  # a lost frame
                    if n not in (10, 38):
                        step(one, n)
                    elif one.wants_detector(n):
                        one.unavailable()
                two = pickle.loads(pickle.dumps(one))
                self.assertEqual(str(one), str(two))
                for n in range(50, 120):
                    self.assertEqual(one.wants_detector(n), two.wants_detector(n))
                    wanted = one._core.wants
                    boxes = [skip.update(found(n)) if wanted else skip.predict() for skip in (one, two)]
                    for mine, other in zip(*(vars(one).values() for one in boxes)):
                        np.testing.assert_array_equal(mine, other)
                self.assertEqual(str(one), str(two))

    def test_a_new_skipper_can_be_pickled(self):
        skip = pickle.loads(pickle.dumps(Skipper("albireo", threshold=5e-4, size=SIZE)))
        self.assertEqual(repr(skip), "<Skipper albireo with u = 0.0005, 1280x720>")

    def test_a_skipper_that_cannot_be_pickled_reports_why(self):
        skip = Skipper(size=SIZE)
        step(skip, 0)
        with self.assertRaisesRegex(TypeError, "resumable=True"):
            pickle.dumps(skip)
        skip = Skipper("expected-loss+flow", size=SIZE, resumable=True)
        skip.look(np.zeros((720, 1280), np.uint8))
        with self.assertRaisesRegex(TypeError, "looked at pictures"):
            pickle.dumps(skip)


class Pause(unittest.TestCase):
    def test_on_an_empty_road_one_frame_in_n_is_looked_at_until_something_is_found(self):
        nothing = (np.zeros((0, 4)), np.zeros(0), np.zeros(0))
        skip = Skipper("albireo", size=SIZE, pause=3, pause_after=4)
        states = []
        for n in range(11):
            boxes = skip.update(nothing) if skip.wants_detector(n) else skip.predict()
            states.append(skip.state)
        self.assertEqual(" ".join(states), "I I I I E E I E E I E")
        self.assertEqual(skip.causes["empty_road"], 2)
        self.assertTrue(skip.wants_detector(12))
        skip.update(found(12))
        self.assertTrue(skip.wants_detector(13))
        self.assertEqual(len(boxes.xyxy), 0)

    def test_a_pause_that_can_change_nothing_is_refused(self):
        with self.assertRaisesRegex(ValueError, "takes no pause"):
            Skipper("expected-loss", size=SIZE, pause=3)
        with self.assertRaisesRegex(ValueError, "whole number of frames"):
            Skipper("albireo", size=SIZE, pause=0.2)


class Late(unittest.TestCase):
    def test_frames_are_answered_at_once_and_late_detections_apply_to_their_own_frame(self):
        late = Skipper(threshold=0.3, size=SIZE, late=True)
        under_way = None
        final = 0
        for n in range(80):
            if late.submit(n):
                self.assertIsNone(under_way)
                under_way = n
            boxes = late.predict()
            if n > 20:
                self.assertEqual(boxes.tracker_id.tolist(), [0, 1, 2])
                np.testing.assert_allclose(boxes.xyxy, found(n)[0], atol=8)
            if under_way is not None and n == under_way + 3:
                boxes = late.deliver(under_way, found(under_way))
                np.testing.assert_allclose(boxes.xyxy, found(under_way)[0], atol=0.1)
                self.assertEqual(set(boxes.source), {"detected"})
                under_way = None
                final += 1
        self.assertEqual((late.frames, late.calls), (80, final))
        self.assertGreater(final, 5)

    def test_a_late_failure_frees_its_frame(self):
        skip = Skipper(size=SIZE, late=True)
        self.assertTrue(skip.submit(0))
        self.assertFalse(skip.submit(1))
        with self.assertRaisesRegex(RuntimeError, "frame 1 does not wait for detections, frame 0 does"):
            skip.deliver(1, found(1))
        skip.deliver(0, None)
        self.assertTrue(skip.submit(2))
        self.assertIn("1 calls failed", str(skip))

    def test_a_call_of_the_other_mode_is_an_error_that_names_the_mode(self):
        late = Skipper(size=SIZE, late=True)
        waiting = Skipper(size=SIZE)
        for call in (late.wants_detector, waiting.submit, lambda: waiting.deliver(0, None), waiting.settled):
            with self.assertRaisesRegex(RuntimeError, r"late=True|submit\(n\)|settle=True"):
                call()
        with self.assertRaisesRegex(ValueError, "cannot take late detections"):
            Skipper("vanilla", size=SIZE, late=True)

    def test_after_a_reset_nothing_is_settled_from_the_stream_before(self):
        skip = Skipper(size=SIZE, settle=True)
        for n in range(3):
            skip.update(found(0)) if skip.wants_detector(n) else skip.predict()
        skip.reset()
        self.assertTrue(skip.wants_detector(3))
        skip.unavailable()
        self.assertTrue(skip.wants_detector(4))
        skip.update(found(0))
        settled = dict(skip.settled(end=True))
        self.assertEqual(len(settled[3].xyxy), 0)

    def test_every_frame_is_settled_once_in_order_and_more_accurately(self):
        def bent(n):
            return found(10 * np.sin(n / 6))

        skip = Skipper("even-skip-in-tracker", threshold=0.8, size=SIZE, settle=True)
        live = []
        settled = []
        for n in range(100):
            live.append(skip.update(bent(n)) if skip.wants_detector(n) else skip.predict())
            settled += skip.settled()
        settled += skip.settled(end=True)
        self.assertEqual([n for n, _ in settled], list(range(100)))
        error = lambda boxes, n: np.abs(boxes.xyxy - bent(n)[0]).mean()
        span = range(20, 90)
        self.assertLess(sum(error(settled[n][1], n) for n in span), 0.8 * sum(error(live[n], n) for n in span))


class Track(unittest.TestCase):
    def pictures(self, count=30):
        return [np.full((720, 1280, 3), n, np.uint8) for n in range(count)]

    def test_track_runs_the_loop_and_skips_detector_calls(self):
        called = []

        def detector(image):
            called.append(int(image[0, 0, 0]))
            return [found(called[-1])]

        tracked = albireo.track(iter(self.pictures()), detector, threshold=0.3)
        with self.assertRaisesRegex(RuntimeError, "no frame yet"):
            tracked.skipper
        self.assertEqual(str(tracked), "<Tracking before its first frame>")
        frames = list(tracked)
        skip = tracked.skipper
        self.assertEqual(len(frames), 30)
        self.assertEqual([frame.number for frame in frames if frame.detected], called)
        self.assertEqual(len(called), skip.calls)
        self.assertLess(skip.calls, 20)
        self.assertEqual(str(tracked), str(skip))
        for n, frame in enumerate(frames):
            self.assertEqual((frame.number, frame.image[0, 0, 0], frame.boxes.tracker_id.tolist()), (n, n, [0, 1, 2]))
            self.assertEqual(frame.detected, frame.state != "P")

    def test_track_passes_pictures_to_flow(self):
        for kind in (lambda image: image, lambda image: image[..., 0], lambda image: image[..., [0, 1, 2, 2]]):
            pictures = map(kind, self.pictures())
            tracked = albireo.track(pictures, lambda image: found(int(image.flat[0])), "expected-loss+flow")
            self.assertEqual(len(list(tracked)), 30)
            self.assertTrue(tracked.skipper.looks)

    def test_track_rejects_unsupported_input_with_a_reason(self):
        detector = lambda image: found(0)
        with mock.patch.dict(sys.modules, cv2=None):
            with self.assertRaisesRegex(ImportError, "pip install opencv-python, or give an iterable"):
                albireo.track("drive.mp4", detector)
        with mock.patch.dict(sys.modules, {"tqdm": None, "tqdm.auto": None}):
            with self.assertRaisesRegex(ImportError, "needs tqdm.*pip install tqdm"):
                albireo.track([], detector, progress=True)
            self.assertEqual(list(albireo.track([], detector)), [])
        with self.assertRaisesRegex(TypeError, "path of a video, the number of a camera or an iterable"):
            albireo.track(7.5, detector)
        with self.assertRaisesRegex(TypeError, "cannot be called"):
            albireo.track([], "yolo26n.pt")
        with self.assertRaisesRegex(TypeError, "the video comes first"):
            albireo.track(detector, "drive.mp4")
        with self.assertRaisesRegex(ValueError, "color_order is 'bgr' .* not 'gbr'"):
            albireo.track([], detector, color_order="gbr")
        with self.assertRaisesRegex(ValueError, "there is no policy `yolo`"):
            albireo.track([], detector, "yolo")
        with self.assertRaisesRegex(TypeError, "picture 0 is no array"):
            list(albireo.track(["frame.jpg"], detector))
        with self.assertRaisesRegex(TypeError, "float64"):
            list(albireo.track([np.zeros((4, 4))], detector))
        with self.assertRaisesRegex(TypeError, r"uint8 of shape \(4, 4, 2\)"):
            list(albireo.track([np.zeros((4, 4, 2), np.uint8)], detector))
        for one in (np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640, 4), np.uint8)):
            with self.assertRaisesRegex(ValueError, r"shape \(480, 640, \d\): this is one picture: give \[picture\]"):
                albireo.track(one, detector)
        with self.assertRaisesRegex(ValueError, "picture 1 has 9x9 pixels"):
            list(albireo.track([np.zeros((720, 1280), np.uint8), np.zeros((9, 9), np.uint8)], detector))


class Look(unittest.TestCase):
    def test_the_order_of_colors_decides_the_brightness(self):
        """A dark and a light stripe in grey, the same as red and cyan: their brightness is that of JPEG."""
        random = np.random.default_rng(1)
        noise = random.integers(0, 256, (480, 700), dtype=np.uint8)

        def boxes(look):
            skip = Skipper("even-skip-in-tracker+flow", threshold=0.9, size=(640, 480))
            xyxy = np.array([[100.0, 100, 200, 200]])
            for n in range(8):
                look(skip, np.ascontiguousarray(noise[:, 2 * n : 2 * n + 640]))
                shown = skip.update((xyxy, [0.9], [0])) if skip.wants_detector(n) else skip.predict()
            return shown.xyxy

        red = lambda grey: np.stack([grey, grey // 2, 255 - grey], -1)
        luma = lambda rgb: ((rgb @ np.array([77, 150, 29]) + 128) // 256).astype(np.uint8)
        grey = boxes(lambda skip, picture: skip.look(luma(red(picture))))
        rgb = boxes(lambda skip, picture: skip.look(red(picture), color_order="rgb"))
        bgr = boxes(lambda skip, picture: skip.look(red(picture)[..., ::-1], color_order="bgr"))
        clear = boxes(lambda skip, picture: skip.look(np.dstack([red(picture), noise[:, :640]]), color_order="rgb"))
        swapped = boxes(lambda skip, picture: skip.look(red(picture), color_order="bgr"))
        columns = boxes(lambda skip, picture: skip.look(np.asfortranarray(red(picture)), color_order="rgb"))
        for same in (rgb, bgr, clear, columns):
            np.testing.assert_array_equal(grey, same)
        self.assertTrue((grey != swapped).any())

    def test_a_picture_in_color_needs_an_order_and_another_shape_is_refused(self):
        skip = Skipper("expected-loss+flow", size=(4, 4))
        with self.assertRaisesRegex(ValueError, r"color_order is 'bgr' \(as OpenCV and Ultralytics .* not None"):
            skip.look(np.zeros((4, 4, 3), np.uint8))
        with self.assertRaisesRegex(ValueError, "3 values for each pixel, or 4 with transparency, not 2"):
            skip.look(np.zeros((4, 4, 2), np.uint8), color_order="rgb")
        for wrong in (np.zeros((4, 4)), np.zeros(4, np.uint8), np.zeros((1, 4, 4, 3), np.uint8)):
            with self.assertRaisesRegex(ValueError, "in uint8, not"):
                skip.look(wrong)


if __name__ == "__main__":
    unittest.main()
