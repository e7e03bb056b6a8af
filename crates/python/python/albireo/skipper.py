"""Decides which frames need the detector, and predicts where the objects are on the others."""

from __future__ import annotations

import warnings
from collections import Counter
from operator import index
from typing import TYPE_CHECKING, Any, Generic, overload

import numpy as np
from numpy.typing import NDArray

from . import _core
from .results import (
    Restore, Boxes, ColorOrder, Columns, Foreign, Image, Picture, Result, as_boxes, checked_order, doubt, named, read,
    real_boxes
)

if TYPE_CHECKING:
    # Type checkers have it built in; nothing is installed.
    from typing_extensions import TypeVar

    Shown = TypeVar("Shown", default=Any)
else:
    from typing import TypeVar

    Shown = TypeVar("Shown")

_CAUSES = {
    "uncertain": "an object became uncertain",
    "new_object": "a new object was uncertain",
    "expected_loss": "the expected loss was worth a call",
    "object_cap": "an object went without the detector for long",
    "periodic_cap": "the stream went without the detector for long",
    "screen": "something is in view",
    "audit": "audit",
    "empty_limit": "the scene was said to be empty for long",
    "empty_road": "a pause on an empty road had ended",
    "no_objects": "no object was followed",
    "start": "first frame",
    "retry": "the call before failed",
    "changed": "the picture changed",
    "schedule": "schedule",
    "every_frame": "every frame",
    "joined": "the detector ran anyway for another camera",
}


def _number(n: Any) -> int:
    """A frame's number."""
    try:
        number = index(n)
    except TypeError:
        raise TypeError(f"a frame's number is a whole number, not {n!r}") from None
    if not 0 <= number < 2**63:
        raise ValueError(f"a frame's number is from 0 to 2**63 - 1, not {number}")
    return number


class Skipper(Generic[Shown]):
    """Decides which frames of a video need the detector, and predicts where the objects are on the others.

    >>> import numpy as np
    >>> from albireo import Skipper
    >>> def model(n):  # one object that moves to the right
    ...     return np.array([[100.0 + n, 100, 180 + n, 160]]), np.array([0.9]), np.array([2])
    >>> skip = Skipper("expected-loss", threshold=0.3, size=(1280, 720))
    >>> for n in range(100):
    ...     if skip.wants_detector(n):
    ...         boxes = skip.update(model(n))
    ...     else:
    ...         boxes = skip.predict()
    >>> boxes.tracker_id
    array([0])
    >>> skip.skipped > 0.5
    True

    One skipper follows one stream. Frame numbers increase and may jump: the objects move on over lost frames.
    `update` takes what the detector found as a tuple of arrays `(xyxy, confidence, class_id)`, as one array with rows of x1,
    y1, x2, y2, confidence and class, as supervision's `Detections` or as Ultralytics' `Results`; boxes come back as the same
    type, with `tracker_id` and `source` ("detected", "predicted", "followed" or "rescued"). Rows come back with the id
    before the confidence and without `source`, as Ultralytics and BoxMOT write tracks. `print(skip)` says what was skipped and
    why the detector was called. For type checkers, `Skipper[supervision.Detections](…)` says what `predict` returns.

    policy: `"expected-loss"`, `"albireo"`, `"fixed-skip"`, … With `+flow` (`"expected-loss+flow"`) optical flow moves the
        boxes of skipped frames; it needs the picture of every frame (`look`).
    threshold: the price of a call; higher skips more. Its name and range depend on the policy (`threshold_spec`).
    size: width and height of the pictures in pixels.
    profile: `"paper"`, or `"reference"` for the published code's decisions.
    pause: on an empty road the detector looks at one frame in this many; 0 looks at every frame. `pause_after` is the number
        of frames without a detection after which the road is empty. For `albireo`: `expected-loss` looks at
        an empty road less often by itself.
    audit: the share of skipped frames that `audit_due` draws, 0 to 1; `seed` decides which.
    late: for a detector in another thread: `submit` and `deliver` take the place of `wants_detector` and `update`.
    settle: `settled` returns every frame again when the next call is known, with boxes interpolated between two calls.
    resumable: stores its input, so that a pickle resumes where it stopped (about 50 bytes per detection).
    """

    def __init__(
        self,
        policy: str = "expected-loss",
        *,
        threshold: float | None = None,
        size: tuple[int, int],
        profile: str = "paper",
        pause: int = 0,
        pause_after: int = 25,
        audit: float = 0.0,
        seed: int = 0,
        late: bool = False,
        settle: bool = False,
        resumable: bool = False,
    ) -> None:
        if not isinstance(policy, str):
            raise TypeError(f"policy is the name of a policy, not {policy!r}")
        try:
            width, height = (index(side) for side in size)
        except (TypeError, ValueError):
            raise ValueError(f"size is (width, height) in pixels, not {size!r}") from None
        if not (0 < width <= 65535 and 0 < height <= 65535):
            raise ValueError(f"size is (width, height) of 1 to 65535 pixels, not {size!r}")
        for name, frames in (("pause", pause), ("pause_after", pause_after)):
            if not isinstance(frames, int) or not 0 <= frames < 2**32:
                raise ValueError(f"{name} is a whole number of frames from 0 to 2**32 - 1, not {frames!r}")
        if not 0.0 <= audit <= 1.0:
            raise ValueError(f"audit is a share of frames from 0 to 1, not {audit!r}")
        if not 0 <= seed < 2**64:
            raise ValueError(f"seed is a whole number from 0 to 2**64 - 1, not {seed!r}")
        self._made_with = (
            policy, profile, threshold, (width, height), (float(audit), seed),
            (bool(late), 256 if settle else None), (pause, pause_after),
        )
        self._core = _core.Decider(*self._made_with)
        self._size = (width, height)
        self._audit = audit > 0.0
        self._late = bool(late)
        self._settle = bool(settle)
        self._names: dict[int, str] = {}
        self._restore: Restore = as_boxes
        self._log: list[tuple[Any, ...]] | None = [] if resumable else None
        self._looked = False
        # Whether the first boxes were looked at: a detector that gives no pixels shows it with these.
        self._judged = False
        self._states: Counter[str] = Counter()
        self._causes: Counter[str] = Counter()
        self._failed = 0
        self._abandoned = 0

    def look(self, image: Image, *, color_order: ColorOrder | None = None) -> None:
        """Takes the picture of the next frame, before its `wants_detector`: 8 bits, grey or in colour.

        Grey has the shape (rows, columns). Colour has (rows, columns, 3), or 4 with transparency, and needs `color_order`,
        "bgr" or "rgb": only its brightness is used. Only policies with `+flow` (and `statues`) look at pictures; without
        one they go on as if they could not see.
        """
        image = np.asarray(image)
        if image.dtype != np.uint8 or image.ndim not in (2, 3):
            raise ValueError(
                f"look takes a picture of shape (rows, columns) or (rows, columns, 3) in uint8, not {image.dtype} {image.shape}"
            )
        if image.ndim == 2:
            self._core.look(image)
        else:
            self._core.look_in_color(image, checked_order(color_order) == "rgb")
        self._looked = True

    def wants_detector(self, n: int | None = None, *, empty: bool | None = None) -> bool:
        """Begins frame `n`, by default the next one, and returns whether the detector should run on it.

        If so, call `update` with what it found, or `unavailable` when it failed; if not, call `predict`. A frame that is
        left without either counts as lost. `empty` is the result of your own cheap check, if you have one: True if
        nothing is in view.
        """
        if self._late:
            raise RuntimeError("this skipper takes late detections: call submit(n), predict() and deliver(n, result)")
        return self._begin(n, empty)

    def submit(self, n: int | None = None, *, empty: bool | None = None) -> bool:
        """Begins frame `n` with `late=True`, and returns whether to give its picture to the detector.

        `predict` returns its boxes at once. Call `deliver` when the detector's result is there; until then no other frame
        needs the detector.
        """
        if not self._late:
            raise RuntimeError("submit(n) is for detections that come late: make the skipper with late=True")
        return self._begin(n, empty)

    @overload
    def deliver(self, n: int, result: Boxes | Columns) -> Boxes: ...
    @overload
    def deliver(self, n: int, result: NDArray[Any]) -> NDArray[Any]: ...
    @overload
    def deliver(self, n: int, result: Foreign) -> Foreign: ...
    @overload
    def deliver(self, n: int, result: None) -> Shown: ...
    def deliver(self, n: int, result: Result | None) -> Any:
        """Takes the detector's result for frame `n`, None if it failed, and returns that frame's final boxes.

        The objects move on from there to the present frame, so the next `predict` includes the result.
        """
        n = _number(n)
        if result is None:
            boxes = named(self._core.deliver(n, None))
            self._failed += 1
        else:
            arrays, restore = read(result, self._size, self._names)
            boxes = named(self._core.deliver(n, arrays))
            self._restore = restore
            self._judge(arrays[0])
        # It was counted as predicted when it was answered.
        state, cause, _ = self._core.delivered
        self._states["P"] -= 1
        self._states[state] += 1
        self._causes[cause or "?"] += 1
        return self._restore(boxes, None)

    def settled(self, *, end: bool = False) -> list[tuple[int, Shown]]:
        """Frames that became final since the last call, each once and in order, with their boxes.

        Needs `settle=True`. Boxes between two detector calls are interpolated; a frame is returned when the next call is
        known, at most 256 frames later. `end=True` returns the remaining frames.
        """
        return [(n, self._restore(named(arrays), None)) for n, _, _, arrays in self._core.settled(end)]

    def _begin(self, n: int | None, empty: bool | None) -> bool:
        core = self._core
        if n is not None:
            n = _number(n)
        was_left = core.wants
        wanted = core.begin(n, None if empty is None else bool(empty))
        if was_left:
            self._abandoned += 1
        if self._log is not None:
            self._log.append(("begin", core.threshold, core.frame, empty))
        if not core.wants:
            self._states[core.state] += 1
        return wanted

    @overload
    def update(self, result: Boxes | Columns) -> Boxes: ...
    @overload
    def update(self, result: NDArray[Any]) -> NDArray[Any]: ...
    @overload
    def update(self, result: Foreign) -> Foreign: ...
    def update(self, result: Result) -> Any:
        """Takes the detector's result for this frame, and returns the boxes to show, as the same type.

        Invalid detections (not finite, sides of zero or less, invalid confidence) are dropped and counted. If the first
        boxes are hardly in pixels (shares of the picture, or all outside it), a warning says so.
        """
        arrays, restore = read(result, self._size, self._names)
        boxes = named(self._core.update(*arrays))
        self._restore = restore
        self._called(("update", *arrays))
        self._judge(arrays[0])
        return restore(boxes, None)

    def unavailable(self, image: Image | None = None, *, color_order: ColorOrder = "bgr") -> Shown:
        """Ends a frame that needed the detector without it, and returns the predicted boxes.

        Use it when the detector failed: the next frame needs it again. `image` is that of `predict`.
        """
        boxes = named(self._core.unavailable())
        self._failed += 1
        self._called(("unavailable",))
        return self._shown(boxes, image, color_order)

    def predict(self, image: Image | None = None, *, color_order: ColorOrder = "bgr") -> Shown:
        """Returns the boxes of a frame that skips the detector, as the type that `update` last took.

        Before the first result they are `Boxes`. `image` becomes the picture of Ultralytics' results (`orig_img`), which
        is BGR: `color_order` is the order in which it is given.
        """
        return self._shown(named(self._core.boxes()), image, color_order)

    def audit_due(self, n: int | None = None) -> bool:
        """Whether frame `n`, by default this one, is in the random sample on which skipping is checked.

        If so, run the detector on it although it was skipped, and give what it found to `audit`: it changes no box, and
        `print(skip)` says how much of what the detector sees had been shown.
        """
        core = self._core
        number = core.frame if n is None else index(n)
        if not self._audit or number is None or number < 0 or number != core.frame:
            return False
        return not core.wants and core.state in ("P", "E") and core.drawn(number)

    def audit(self, result: Result) -> None:
        """Compares the boxes of this frame, which was skipped, with what the detector finds on it."""
        arrays, _ = read(result, self._size, dict(self._names))
        self._core.compare(*arrays)

    def reset(self) -> None:
        """Forgets all objects: the next frame begins a new stream. Threshold and totals stay."""
        self._core.reset()
        self._restore = as_boxes
        if self._log is not None:
            self._log.append(("reset",))

    @property
    def threshold(self) -> float | None:
        """The policy's threshold; may be set, and applies from the next frame. None for a policy without one."""
        return self._core.threshold

    @threshold.setter
    def threshold(self, value: float) -> None:
        self._core.threshold = value

    @property
    def policy(self) -> str:
        """The policy's name."""
        return self._core.policy

    @property
    def threshold_spec(self) -> tuple[str, str, float, float] | None:
        """Name, meaning, smallest and largest value of the threshold."""
        return self._core.threshold_spec

    @property
    def looks(self) -> bool:
        """Whether the policy needs pictures (`look`)."""
        return self._core.looks

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures in pixels."""
        return self._size

    @property
    def frame(self) -> int | None:
        """The number of the present frame."""
        return self._core.frame

    @property
    def state(self) -> str:
        """The state of the last decided frame: "P" or "E" where the detector was skipped, "I", "AI" or "E+I" where it ran."""
        return self._core.state

    @property
    def cause(self) -> str | None:
        """Why the detector was called for the last decided frame; None where it was skipped."""
        return self._core.cause

    @property
    def frames(self) -> int:
        """Frames decided so far."""
        return self._states.total()

    @property
    def calls(self) -> int:
        """Frames so far for which the detector was called."""
        return self._causes.total()

    @property
    def skipped(self) -> float:
        """Share of the frames so far that skipped the detector, 0 to 1."""
        return 1.0 - self.calls / self.frames if self.frames else 0.0

    @property
    def causes(self) -> dict[str, int]:
        """How often the detector was called for each cause."""
        return dict(self._causes)

    @property
    def recall(self) -> tuple[float, float, float] | None:
        """Share of the detector's boxes on audited frames that had been shown, and its 95 % interval."""
        return self._core.recall()

    def __str__(self) -> str:
        skipped = self.frames - self.calls
        lines = [f"{self!r}: {skipped} of {self.frames} frames skipped ({self.skipped:.0%}), {self.calls} detector calls"]
        lines += [f"  {count} because {_CAUSES.get(cause, cause)}" for cause, count in self._causes.most_common()]
        if self._failed:
            lines.append(f"  {self._failed} calls failed")
        if self._abandoned:
            lines.append(f"  {self._abandoned} frames were left without a result")
        if self._core.refused:
            lines.append(f"  {self._core.refused} detections were no box and left out")
        if recall := self.recall:
            rate, low, high = recall
            lines.append(f"  audit: {rate:.1%} [{low:.1%}, {high:.1%}] of what the detector sees had been shown")
        return "\n".join(lines)

    def __repr__(self) -> str:
        spec = self.threshold_spec
        threshold = f" with {spec[0]} = {self.threshold:g}" if spec and self.threshold is not None else ""
        return f"<Skipper {self.policy}{threshold}, {self._size[0]}x{self._size[1]}>"

    def _shown(self, boxes: Boxes, image: Image | None, color_order: ColorOrder) -> Shown:
        """Boxes as the type that `update` last took."""
        picture = None if image is None else Picture(image, checked_order(color_order))
        shown: Shown = self._restore(boxes, picture)
        return shown

    def _judge(self, xyxy: NDArray[np.float64]) -> None:
        """Warns if the first boxes are hardly in pixels of the picture."""
        if self._judged:
            return
        boxes = real_boxes(xyxy)
        if len(boxes) == 0:
            return
        self._judged = True
        reason = doubt(boxes, self._size)
        if reason is not None:
            warnings.warn(reason, stacklevel=3)

    def _called(self, event: tuple[Any, ...]) -> None:
        """Counts a frame for which the detector was called."""
        self._states[self._core.state] += 1
        self._causes[self._core.cause or "?"] += 1
        if self._log is not None:
            self._log.append(event)

    def __getstate__(self) -> dict[str, Any]:
        if self._core.frame is not None and self._log is None:
            raise TypeError(
                "this skipper has followed a stream and cannot be pickled: make it with resumable=True, or pickle it before "
                "its first frame"
            )
        if self._late or self._settle:
            raise TypeError("a skipper with late=True or settle=True cannot be pickled")
        if self._looked:
            raise TypeError("a skipper that has looked at pictures cannot be pickled: they are not kept")
        state = self.__dict__.copy()
        # The type of boxes is known again with the next update.
        del state["_core"], state["_restore"]
        return state | {"threshold": self.threshold}

    def __setstate__(self, state: dict[str, Any]) -> None:
        threshold = state.pop("threshold")
        self.__dict__.update(state)
        self._core = _core.Decider(*self._made_with)
        self._restore = as_boxes
        for name, *given in self._log or []:
            if name == "begin":
                held, n, empty = given
                if held is not None:
                    self._core.threshold = held
                self._core.begin(n, empty)
            else:
                getattr(self._core, name)(*given)
        if threshold is not None:
            self._core.threshold = threshold


