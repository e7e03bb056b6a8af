"""Checks that any input gives an answer or a clear error, and never a crash."""

import unittest

import numpy as np
from hypothesis import given, settings, strategies as st

from albireo import Skipper

POLICIES = [
    "albireo", "vanilla", "fixed-skip", "ctd", "statues", "erd-only", "kill-only", "kill+erd",
    "kill+erd-10d", "expected-loss", "expected-loss+flow", "fixed-skip-in-tracker", "even-skip-in-tracker",
]
NUMBERS = st.one_of(
    st.floats(-2000, 2000),
    st.sampled_from([0.0, -0.0, np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 1e-30, 65535, 65536, -1, 0.5, 1.0]),
)
DTYPES = ["f2", "f4", "f8", ">f8", "g", "i1", "i8", "u8", "?", "O", "c16", "U8", "M8[s]"]


@st.composite
def arrays(draw, columns=None):
    """An array of any type and layout, more often than not of the right shape."""
    rows = draw(st.integers(0, 6))
    shape = draw(st.sampled_from([(rows, columns) if columns else (rows,)] * 5 + [(), (rows, 5), (2, rows, 4), (4,), (0,)]))
    count = int(np.prod(shape))
    values = draw(st.lists(NUMBERS, min_size=count, max_size=count))
    with np.errstate(all="ignore"):
        dtype = draw(st.sampled_from(["f8"] * 8 + ["f4"] * 4 + DTYPES))
        numbers = np.array(values, "f8").reshape(shape)
        array = (np.nan_to_num(numbers) % 100).astype(dtype) if dtype[-1] not in "f248?g" else numbers.astype(dtype)
    array = np.asarray(array)  # NumPy arithmetic turns a 0-d array into a scalar
    match draw(st.integers(0, 5)):
        case 0:
            return np.asfortranarray(array)
        case 1:
            return np.repeat(array, 2, axis=0)[::2] if array.ndim else array
        case 2:
            return array[::-1] if array.ndim else array
        case 3 if array.dtype.kind in "fiu":
            raw = np.frombuffer(b"\0" + array.tobytes(), np.uint8)[1:]
            return raw.view(array.dtype).reshape(array.shape)  # not aligned
        case 4:
            array.flags.writeable = False
            return array
    return draw(st.sampled_from([array, array.tolist()]))


@st.composite
def boxes(draw):
    """Detections of matching lengths with arbitrary numbers."""
    count = draw(st.integers(0, 8))
    kind = draw(st.sampled_from(["f4", "f8"]))
    with np.errstate(all="ignore"):
        xyxy = np.array(draw(st.lists(NUMBERS, min_size=4 * count, max_size=4 * count)), kind).reshape(count, 4)
        confidence = np.array(draw(st.lists(NUMBERS, min_size=count, max_size=count)), kind)
    return xyxy, confidence, np.array(draw(st.lists(st.integers(0, 3), min_size=count, max_size=count)), int)


RESULTS = st.one_of(
    boxes(),
    st.tuples(arrays(4), arrays(), arrays()),
    st.sampled_from([None, (), [], "boxes", 7, object(), (None, None, None), ([[]], [], []), ({}, {}, {})]),
)
FRAMES = st.one_of(st.none(), st.integers(-5, 400), st.sampled_from([2**32, 2**62, 2**63, 2**64, 1.5, "1", True]))
PICTURES = st.sampled_from([(0, 0), (1, 1), (2, 3), (5,), (48, 64), (64, 48), (1, 300), (70000, 1), (4, 4, 3), (1, 1, 4), (48, 64, 5), (0, 4, 3)])
STEPS = st.one_of(
    st.tuples(st.just("wants_detector"), FRAMES),
    st.tuples(st.just("wants_detector"), st.none()),
    st.tuples(st.just("update"), RESULTS),
    st.tuples(st.just("update"), boxes()),
    st.tuples(st.just("audit"), RESULTS),
    st.tuples(st.just("audit_due"), FRAMES),
    st.tuples(st.just("submit"), FRAMES),
    st.tuples(st.just("submit"), st.none()),
    st.tuples(st.just("deliver"), FRAMES, RESULTS),
    st.tuples(st.just("deliver"), st.integers(0, 5), boxes()),
    st.tuples(st.just("look"), PICTURES),
    st.tuples(st.sampled_from(["predict", "unavailable", "reset", "settled"])),
)


class Hostile(unittest.TestCase):
    @settings(max_examples=400, deadline=None, derandomize=True, database=None)
    @given(st.booleans(), st.sampled_from(POLICIES), st.sampled_from([(1280, 720), (1, 1), (65535, 3)]), st.lists(STEPS, max_size=40))
    def test_any_calls_with_any_input_give_an_answer_or_an_error_message(self, late, policy, size, steps):
        late = late and policy.startswith(("albireo", "expected-loss"))
        skip = Skipper(policy, size=size, audit=0.5, late=late, settle=True)
        for name, *given in steps:
            named = {}
            if name == "look":
                given = [np.random.default_rng(0).integers(0, 255, given[0], dtype=np.uint8)]
                named = {"color_order": "rgb"} if given[0].ndim == 3 else {}
            try:
                with np.errstate(all="ignore"):
                    answer = getattr(skip, name)(*given, **named)
            except (ValueError, TypeError, RuntimeError) as error:
                self.assertGreater(len(str(error)), 10)
                continue
            if name in ("update", "predict", "unavailable", "deliver"):
                self.assertEqual(answer.xyxy.shape, (len(answer.confidence), 4))
                self.assertTrue(np.isfinite(answer.confidence).all())
                self.assertTrue(((answer.confidence >= 0) & (answer.confidence <= 1)).all())
                if answer.xyxy.dtype == np.float64:
                    self.assertTrue(np.isfinite(answer.xyxy).all(), answer)
            str(skip), repr(skip), skip.frames

    def test_invalid_boxes_are_left_out_and_counted(self):
        skip = Skipper(size=(640, 480))
        skip.wants_detector(0)
        xyxy = np.array([[10, 10, 50, 50], [np.nan, 0, 9, 9], [50, 50, 10, 10], [0, 0, np.inf, 9], [5, 5, 5, 9], [60, 60, 90, 90]])
        boxes = skip.update((xyxy, np.array([0.9, 0.9, 0.9, 0.9, 0.9, np.nan]), np.zeros(6)))
        np.testing.assert_allclose(boxes.xyxy, xyxy[:1], rtol=1e-14)
        self.assertIn("5 detections were no box and left out", str(skip))

    def test_an_invalid_picture_is_rejected(self):
        skip = Skipper("expected-loss+flow", size=(640, 480))
        for picture in (np.zeros((4, 4)), np.zeros((0, 4), np.uint8), np.zeros((4, 0, 3), np.uint8), "frame.jpg"):
            with self.assertRaisesRegex(ValueError, "look takes a picture|its sides must be"):
                skip.look(picture, color_order="rgb")

    def test_thousands_of_boxes_are_accepted(self):
        random = np.random.default_rng(0)
        corner = random.uniform(0, 1200, (3000, 2))
        skip = Skipper(size=(1280, 720))
        for n in range(3):
            if skip.wants_detector(n):
                skip.update((np.hstack([corner, corner + 20]), np.full(3000, 0.9), np.zeros(3000)))
        self.assertGreater(skip.frames, 0)


if __name__ == "__main__":
    unittest.main()
