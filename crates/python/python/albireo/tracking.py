"""Tracks the objects of a video and runs the loop itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from os import PathLike, fspath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .skipper import Skipper


class Tracked(NamedTuple):
    """A frame of `track`."""

    image: NDArray[np.uint8]
    """The picture."""
    boxes: Any
    """Its boxes, as the type that the model returns."""
    skip: Skipper
    """The skipper, for `skip.state`, `skip.cause` and `print(skip)`."""


def track(
    model: Callable[[NDArray[np.uint8]], Any],
    source: str | PathLike[str] | Iterable[NDArray[np.uint8]],
    policy: str = "expected-loss",
    *,
    threshold: float | None = None,
    **settings: Any,
) -> Iterator[Tracked]:
    """Yields image, boxes and skipper for every frame of a video, and runs the detector only where it is needed.

        for image, boxes, skip in albireo.track(model, "drive.mp4"):
            ...
        print(skip)

    model: takes a picture, returns what `Skipper.update` takes, or a list with it (as Ultralytics' models do).
    source: any iterable of pictures, arrays of shape (rows, columns) or (rows, columns, colours) in 8 bits, all of one
        size; or the path or address of a video, which OpenCV reads (`pip install opencv-python`).
    policy, threshold, settings: as `Skipper` takes them; the size is that of the first picture.
    """
    if not callable(model):
        raise TypeError(f"model is called with a picture; {type(model).__name__} cannot be called")
    if isinstance(source, (str, PathLike)):
        pictures: Iterable[Any] = _video(fspath(source))
    elif isinstance(source, Iterable):
        pictures = source
    else:
        raise TypeError(f"source is an iterable of pictures or the path of a video, not {type(source).__name__}")
    return _track(model, pictures, policy, {"threshold": threshold, **settings})


def _track(
    model: Callable[[Any], Any], pictures: Iterable[Any], policy: str, settings: dict[str, Any]
) -> Iterator[Tracked]:
    skip: Skipper | None = None
    for n, image in enumerate(pictures):
        shape: tuple[int, ...] = getattr(image, "shape", ())
        if len(shape) not in (2, 3) or 0 in shape or getattr(image, "dtype", None) != np.uint8:
            raise TypeError(f"picture {n} is no array of shape (rows, columns[, colours]) in uint8, but {_kind(image)}")
        size = (shape[1], shape[0])
        if skip is None:
            skip = Skipper(policy, size=size, **settings)
        if size != skip.size:
            raise ValueError(f"picture {n} has {size[0]}x{size[1]} pixels, those before {skip.size[0]}x{skip.size[1]}")
        if skip.looks:
            # Of the colours green is closest to brightness.
            skip.look(image if image.ndim == 2 else image[..., image.shape[2] // 2])
        if skip.wants_detector(n):
            found = model(image)
            if isinstance(found, list) and len(found) == 1:
                found = found[0]
            boxes = skip.update(found)
        else:
            boxes = skip.predict(image)
        yield Tracked(image, boxes, skip)


def _kind(image: Any) -> str:
    shape, dtype = getattr(image, "shape", None), getattr(image, "dtype", None)
    return type(image).__name__ if shape is None else f"{dtype} of shape {tuple(shape)}"


def _video(path: str) -> Iterator[Any]:
    try:
        import cv2  # type: ignore[import-not-found, unused-ignore]
    except ImportError:
        raise ImportError(
            f"OpenCV reads {path!r} and is not installed: pip install opencv-python, or give an iterable of pictures"
        ) from None
    video = cv2.VideoCapture(path)
    if not video.isOpened():
        raise FileNotFoundError(f"OpenCV cannot open {path!r} as a video")
    return _frames(video)


def _frames(video: Any) -> Iterator[Any]:
    try:
        while True:
            there, image = video.read()
            if not there:
                return
            yield image
    finally:
        video.release()
