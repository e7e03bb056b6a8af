"""Tracks the objects of a video and runs the loop itself."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sized
from dataclasses import dataclass
from os import PathLike, fspath
from typing import Any, Generic, TypeAlias, TypeVar, Union, overload

import numpy as np
from numpy.typing import NDArray

from .results import Boxes, ColorOrder, Columns, Foreign, Image, checked_order
from .skipper import Skipper

Shown = TypeVar("Shown")

Video: TypeAlias = Union[str, "PathLike[str]", int, Iterable[Image]]
"""The path or address of a video, the number of a camera, or pictures."""

# A container's number of frames may be an estimate: below this share of it a video has ended early.
_WHOLE = 0.95


@dataclass(frozen=True)
class Tracked(Generic[Shown]):
    """A frame of `track`."""

    number: int
    """Its number, from 0."""
    image: Image
    """The picture, as the detector gets it."""
    boxes: Shown
    """Its boxes, as the type that the detector returns, with ids."""
    state: str
    """"P" or "E" where the detector was skipped, "I", "AI" or "E+I" where it ran."""
    cause: str | None
    """Why the detector ran; None where it was skipped."""

    @property
    def detected(self) -> bool:
        """Whether the detector ran on this frame."""
        return self.cause is not None


class Tracking(Iterator[Tracked[Shown]]):
    """The frames of `track`, one by one. `print` says what was skipped so far and why the detector was called."""

    def __init__(self, frames: Callable[[Tracking[Shown]], Iterator[Tracked[Shown]]]) -> None:
        self._skipper: Skipper[Shown] | None = None
        self._frames = frames(self)

    def __next__(self) -> Tracked[Shown]:
        return next(self._frames)

    @property
    def skipper(self) -> Skipper[Shown]:
        """The skipper, with all figures. It is made with the first frame."""
        if self._skipper is None:
            raise RuntimeError("there is no frame yet: the skipper is made with the first one")
        return self._skipper

    def __str__(self) -> str:
        return repr(self) if self._skipper is None else str(self._skipper)

    def __repr__(self) -> str:
        return "<Tracking before its first frame>" if self._skipper is None else f"<Tracking by {self._skipper!r}>"


@overload
def track(
    video: Video, detector: Callable[[Image], Boxes | Columns], policy: str = ..., *, threshold: float | None = ...,
    color_order: ColorOrder = ..., progress: bool | None = ..., profile: str = ..., audit: float = ..., seed: int = ...,
) -> Tracking[Boxes]: ...
@overload
def track(
    video: Video, detector: Callable[[Image], NDArray[Any]], policy: str = ..., *, threshold: float | None = ...,
    color_order: ColorOrder = ..., progress: bool | None = ..., profile: str = ..., audit: float = ..., seed: int = ...,
) -> Tracking[NDArray[Any]]: ...
@overload
def track(
    video: Video, detector: Callable[[Image], Foreign | list[Foreign]], policy: str = ..., *, threshold: float | None = ...,
    color_order: ColorOrder = ..., progress: bool | None = ..., profile: str = ..., audit: float = ..., seed: int = ...,
) -> Tracking[Foreign]: ...
def track(
    video: Video,
    detector: Callable[[Image], Any],
    policy: str = "expected-loss",
    *,
    threshold: float | None = None,
    color_order: ColorOrder = "bgr",
    progress: bool | None = None,
    profile: str = "paper",
    audit: float = 0.0,
    seed: int = 0,
) -> Tracking[Any]:
    """Goes through a video and runs the detector only on the frames that need it.

        tracked = albireo.track("drive.mp4", detector)
        for frame in tracked:
            frame.image, frame.boxes                   # also frame.number, .detected, .state and .cause
        print(tracked)                                 # what was skipped, and why each call was made

    video: the path or address of a video or the number of a camera, which OpenCV reads (`pip install opencv-python`); or
        pictures, any iterable of arrays of shape (rows, columns) or (rows, columns, 3 or 4) in 8 bits, all of one size.
    detector: takes a picture, returns what `Skipper.update` takes, or a list with it (as Ultralytics' models do).
    color_order: the order of the colours in the pictures that the detector gets: "bgr", as OpenCV and Ultralytics have
        them, or "rgb", as Pillow and PyTorch do. A video is converted to it; pictures that you give must have it.
    progress: a progress bar on the error output, by tqdm (`pip install tqdm`). None: in a terminal, if tqdm is installed.
    audit: the share of skipped frames on which the detector also runs to check the boxes that were shown, 0 to 1: it
        changes none, and `print` says how much of what the detector sees had been shown.
    policy, threshold, profile, seed: as `Skipper` takes them; the size is that of the first picture.
    """
    if not callable(detector):
        swapped = " (the video comes first)" if callable(video) else ""
        raise TypeError(f"the detector is called with a picture; {type(detector).__name__} cannot be called{swapped}")
    color_order = checked_order(color_order)
    new_bar = _progress_bar(progress)
    pictures: Iterable[Any]
    total: int | None
    if isinstance(video, (str, PathLike, int)):
        source = video if isinstance(video, int) else fspath(video)
        capture, total = _open(source)
        pictures = _frames(capture, source, total, color_order)
    elif isinstance(video, np.ndarray) and video.ndim == 3 and video.shape[2] in (3, 4) and min(video.shape[:2]) > 4:
        raise ValueError(f"video is an array of shape {video.shape}: this is one picture: give [picture]")
    elif isinstance(video, Iterable):
        pictures = video
        total = len(video) if isinstance(video, Sized) else None
    else:
        raise TypeError(
            f"video is the path of a video, the number of a camera or an iterable of pictures, not {type(video).__name__}"
        )
    settings: dict[str, Any] = {"threshold": threshold, "profile": profile, "audit": audit, "seed": seed}
    # A wrong setting is an error of this call, not of the first frame.
    Skipper(policy, size=(1, 1), **settings)

    def frames(tracking: Tracking[Any]) -> Iterator[Tracked[Any]]:
        bar = None if new_bar is None else new_bar(total=total, unit=" frames")
        try:
            for frame, skip in _track(pictures, detector, policy, color_order, settings):
                tracking._skipper = skip
                if bar is not None:
                    bar.update()
                    bar.set_postfix_str(f"{skip.skipped:.0%} skipped", refresh=False)
                yield frame
        finally:
            if bar is not None:
                bar.close()

    return Tracking(frames)


def _track(
    pictures: Iterable[Any], detector: Callable[[Any], Any], policy: str, color_order: ColorOrder, settings: dict[str, Any]
) -> Iterator[tuple[Tracked[Any], Skipper[Any]]]:
    skip: Skipper[Any] | None = None
    for n, image in enumerate(pictures):
        shape: tuple[int, ...] = getattr(image, "shape", ())
        has_pixels = 0 not in shape and getattr(image, "dtype", None) == np.uint8
        is_grey = len(shape) == 2
        is_colored = len(shape) == 3 and shape[2] in (3, 4)
        if not has_pixels or not (is_grey or is_colored):
            raise TypeError(f"picture {n} is no array of shape (rows, columns) or (rows, columns, 3) in uint8, but {_kind(image)}")
        size = (shape[1], shape[0])
        if skip is None:
            skip = Skipper(policy, size=size, **settings)
        if size != skip.size:
            raise ValueError(f"picture {n} has {size[0]}x{size[1]} pixels, those before {skip.size[0]}x{skip.size[1]}")
        if skip.looks:
            skip.look(image, color_order=color_order)
        if skip.wants_detector(n):
            boxes = skip.update(_one(detector(image)))
        else:
            boxes = skip.predict(image, color_order=color_order)
            if skip.audit_due():
                skip.audit(_one(detector(image)))
        yield Tracked(n, image, boxes, skip.state, skip.cause), skip


def _one(found: Any) -> Any:
    """A detector's result, which may be in a list."""
    return found[0] if isinstance(found, list) and len(found) == 1 else found


def _kind(image: Any) -> str:
    shape = getattr(image, "shape", None)
    if shape is None:
        return type(image).__name__
    return f"{getattr(image, 'dtype', None)} of shape {tuple(shape)}"


def _progress_bar(progress: bool | None) -> Any:
    """The class of tqdm's bar, or None where none is wanted."""
    if progress is False or (progress is None and not sys.stderr.isatty()):
        return None
    try:
        from tqdm.auto import tqdm  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        if progress is None:
            return None
        raise ImportError("the progress bar needs tqdm, which is not installed: pip install tqdm") from None
    return tqdm


def _open(source: str | int) -> tuple[Any, int | None]:
    """A video that OpenCV has opened, and its number of frames, where it is known."""
    try:
        import cv2  # type: ignore[import-not-found, unused-ignore]
    except ImportError:
        raise ImportError(
            f"OpenCV reads {source!r} and is not installed: pip install opencv-python, or give an iterable of pictures"
        ) from None
    video = cv2.VideoCapture(source)
    if not video.isOpened():
        raise FileNotFoundError(f"OpenCV cannot open {source!r} as a video")
    count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    return video, count if count > 0 else None


def _frames(video: Any, source: str | int, total: int | None, color_order: ColorOrder) -> Iterator[Any]:
    import cv2

    read = 0
    try:
        while True:
            is_read, image = video.read()
            if not is_read:
                break
            read += 1
            yield cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if color_order == "rgb" else image
    finally:
        video.release()
    if read == 0:
        raise ValueError(f"OpenCV has opened {source!r} but reads no picture of it")
    # OpenCV gives no reason when a video ends early.
    if total is not None and read < _WHOLE * total:
        warnings.warn(f"{source!r} has {total} frames and OpenCV could read {read}: the file may be cut or damaged", stacklevel=2)
