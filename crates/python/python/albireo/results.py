"""Reads the results of detectors, and gives boxes back as the type that was read.

Foreign types are read by their attributes: neither supervision nor Ultralytics is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias, TypeVar, Union, get_args, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core

_SOURCES = np.array(_core.SOURCES)

ColorOrder: TypeAlias = Literal["bgr", "rgb"]
"""The order of a picture's colours: "bgr" is that of OpenCV and Ultralytics, "rgb" that of Pillow and PyTorch."""

Image: TypeAlias = NDArray[np.uint8]
"""A picture of 8 bits: shape (rows, columns), (rows, columns, 3) or (rows, columns, 4), the last with transparency."""


class Box(NamedTuple):
    """One of `Boxes`."""

    xyxy: tuple[float, float, float, float]
    """Left, top, right, bottom in pixels."""
    confidence: float
    """0 to 1."""
    class_id: int
    """The detector's class number."""
    tracker_id: int
    """The object's number, -1 where a policy follows no objects."""
    source: str
    """"detected", "predicted", "followed" (by optical flow) or "rescued" (the detector missed it)."""


@dataclass(eq=False)
class Boxes:
    """The boxes of a frame as arrays, one row for each box. `for box in boxes` goes through them as `Box`.

    `len(boxes)` is their number, `boxes[0]` the first, and `boxes[boxes.class_id == 2]` those of a class. They can be
    given to `Skipper.update` as they are.
    """

    xyxy: NDArray[Any]
    """Left, top, right, bottom in pixels: shape (N, 4). Predicted boxes may reach out of the picture."""
    confidence: NDArray[Any]
    """0 to 1: shape (N,)."""
    class_id: NDArray[np.int64]
    """The detector's class numbers: shape (N,)."""
    tracker_id: NDArray[np.int64]
    """The same number for the same object on every frame, -1 where a policy follows no objects: shape (N,)."""
    source: NDArray[np.str_]
    """"detected", "predicted", "followed" (by optical flow) or "rescued" (the detector missed it): shape (N,)."""

    def __len__(self) -> int:
        return len(self.xyxy)

    def __iter__(self) -> Iterator[Box]:
        columns = (self.confidence, self.class_id, self.tracker_id, self.source)
        rows = zip(self.xyxy.tolist(), *(column.tolist() for column in columns))
        return (Box((left, top, right, bottom), *row) for (left, top, right, bottom), *row in rows)

    @overload
    def __getitem__(self, which: int | np.integer[Any]) -> Box: ...
    @overload
    def __getitem__(self, which: slice | NDArray[np.bool_] | NDArray[np.integer[Any]] | list[int] | list[bool]) -> Boxes: ...
    def __getitem__(self, which: Any) -> Box | Boxes:
        columns = (self.xyxy, self.confidence, self.class_id, self.tracker_id, self.source)
        if isinstance(which, (int, np.integer)):
            xyxy, *row = (column[which].tolist() for column in columns)
            return Box((xyxy[0], xyxy[1], xyxy[2], xyxy[3]), *row)
        return Boxes(*(column[which] for column in columns))


class SupervisionDetections(Protocol):
    """What is read of supervision's `Detections`."""

    @property
    def xyxy(self) -> Any: ...
    @property
    def confidence(self) -> Any: ...
    @property
    def class_id(self) -> Any: ...


class UltralyticsResults(Protocol):
    """What is read of Ultralytics' `Results`."""

    @property
    def boxes(self) -> Any: ...
    @property
    def orig_shape(self) -> Any: ...


Columns: TypeAlias = tuple[ArrayLike, ArrayLike, ArrayLike]
"""Boxes (N, 4), confidences (N,) and classes (N,): arrays, lists or tensors."""

Foreign = TypeVar("Foreign", bound=Union[SupervisionDetections, UltralyticsResults])
"""Another package's type of results, which comes back as it went in."""

Result: TypeAlias = Union[Boxes, Columns, NDArray[Any], SupervisionDetections, UltralyticsResults]
"""Everything that `Skipper.update` takes."""

Arrays: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


class Picture(NamedTuple):
    """A picture and the order of its colours."""

    image: Image
    color_order: ColorOrder

    def bgr(self) -> Image:
        """The picture in OpenCV's order."""
        if self.color_order == "bgr" or self.image.ndim == 2:
            return self.image
        return np.ascontiguousarray(self.image[..., 2::-1])


Restore: TypeAlias = Callable[[Boxes, Union[Picture, None]], Any]
"""Makes of `Boxes` the type that a result had; the picture is that of the frame, where it is given."""


def checked_order(color_order: Any) -> ColorOrder:
    """`color_order`, if it is one."""
    for order in get_args(ColorOrder):
        if color_order == order:
            return order  # type: ignore[no-any-return]
    raise ValueError(
        f"color_order is 'bgr' (as OpenCV and Ultralytics have pictures) or 'rgb' (as Pillow and PyTorch), not {color_order!r}"
    )


def read(result: Any, size: tuple[int, int], names: dict[int, str]) -> tuple[Arrays, Restore]:
    """The boxes, confidences and classes of a result, and the function that makes the same type of boxes again.

    `names` gets the names of classes, where supervision's detections have them.
    """
    if isinstance(result, Boxes):
        result = (result.xyxy, result.confidence, result.class_id)
    if isinstance(result, tuple):
        return _read_tuple(result)
    if isinstance(result, np.ndarray):
        return _read_rows(result)
    if hasattr(result, "xyxy") and hasattr(result, "class_id"):
        return _read_supervision(result, names)
    if hasattr(result, "boxes") and hasattr(result, "orig_shape"):
        return _read_ultralytics(result, size)
    hint = ""
    if isinstance(result, list):
        hint = " (Ultralytics' models return a list with one result for each picture: give one of them)"
    raise TypeError(
        f"cannot read detections of type {type(result).__name__}: give a tuple (xyxy, confidence, class_id) of arrays, "
        f"an array with rows of x1, y1, x2, y2, confidence and class, supervision's Detections or one of Ultralytics' "
        f"Results{hint}"
    )


def as_boxes(boxes: Boxes, _picture: Picture | None) -> Boxes:
    """Gives back arrays."""
    return boxes


def _read_tuple(result: tuple[Any, ...]) -> tuple[Arrays, Restore]:
    if len(result) != 3:
        raise ValueError(f"a tuple of detections is (xyxy, confidence, class_id), not of length {len(result)}")
    xyxy, dtype = _boxes(result[0])
    arrays = xyxy, _column(result[1], "confidence"), _column(result[2], "class_id")
    if dtype == np.float64:
        return arrays, as_boxes

    def restore(boxes: Boxes, _picture: Picture | None) -> Boxes:
        boxes.xyxy = boxes.xyxy.astype(dtype)
        boxes.confidence = boxes.confidence.astype(dtype)
        return boxes

    return arrays, restore


def _read_rows(rows: NDArray[Any]) -> tuple[Arrays, Restore]:
    if rows.ndim != 2 or rows.shape[1] != 6:
        raise ValueError(
            f"an array of detections has the shape {rows.shape}; it must be (N, 6): x1, y1, x2, y2, confidence, class"
        )
    xyxy, dtype = _boxes(rows[:, :4])
    dtype = _with_ids(dtype)
    arrays = xyxy, _column(rows[:, 4], "confidence"), _column(rows[:, 5], "class")

    def restore(boxes: Boxes, _picture: Picture | None) -> NDArray[Any]:
        return np.column_stack([boxes.xyxy, boxes.tracker_id, boxes.confidence, boxes.class_id]).astype(dtype)

    return arrays, restore


def _read_supervision(result: Any, names: dict[int, str]) -> tuple[Arrays, Restore]:
    xyxy, dtype = _boxes(result.xyxy)
    count = len(xyxy)
    confidence = np.ones(count) if result.confidence is None else _column(result.confidence, "confidence")
    class_id = np.zeros(count) if result.class_id is None else _column(result.class_id, "class_id")
    known = (getattr(result, "data", None) or {}).get("class_name")
    if known is not None and len(known) == len(class_id):
        names.update(zip(class_id.tolist(), map(str, known)))
    kind = type(result)

    def restore(boxes: Boxes, _picture: Picture | None) -> Any:
        data: dict[str, Any] = {"source": boxes.source}
        if names:
            data["class_name"] = np.array([names.get(number, "") for number in boxes.class_id.tolist()], dtype=str)
        return kind(
            xyxy=boxes.xyxy.astype(dtype),
            confidence=boxes.confidence.astype(dtype),
            class_id=boxes.class_id,
            tracker_id=boxes.tracker_id,
            data=data,
        )

    return (xyxy, confidence, class_id), restore


def _read_ultralytics(result: Any, size: tuple[int, int]) -> tuple[Arrays, Restore]:
    found = result.boxes
    if found is None:
        raise TypeError("the result has no boxes: oriented boxes and classifications cannot be tracked")
    height, width = (int(side) for side in result.orig_shape)
    if (width, height) != size:
        raise ValueError(f"the result is of a picture of {width}x{height} pixels; this skipper takes {size[0]}x{size[1]}")
    xyxy, dtype = _boxes(found.xyxy)
    arrays = xyxy, _column(found.conf, "boxes.conf"), _column(found.cls, "boxes.cls")
    blank = result.new()
    row_type = _with_ids(dtype)
    # A tensor on the device of the result, where it is one; a new tensor has the type of the one that makes it.
    data = found.data.float() if row_type != dtype and hasattr(found.data, "float") else found.data
    make = getattr(data, "new_tensor", None)

    def restore(boxes: Boxes, picture: Picture | None) -> Any:
        rows = np.column_stack([boxes.xyxy, boxes.tracker_id, boxes.confidence, boxes.class_id]).astype(row_type)
        shown = blank.new()
        if picture is not None:
            shown.orig_img = picture.bgr()
        shown.update(boxes=make(rows) if make else rows)
        shown.source = boxes.source
        return shown

    return arrays, restore


def _numbers(value: Any, what: str) -> NDArray[Any]:
    """`value`, which may be a tensor, as an array of real numbers."""
    for step in ("detach", "cpu", "numpy"):
        if hasattr(value, step):
            value = getattr(value, step)()
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from None
    if array.dtype.kind not in "fiub" and array.size:
        raise TypeError(f"{what} must be real numbers, not {array.dtype}")
    return array


def _boxes(value: Any) -> tuple[NDArray[np.float64], np.dtype[Any]]:
    array = _numbers(value, "the boxes (xyxy)")
    dtype = array.dtype if array.dtype.kind == "f" else np.dtype(np.float64)
    if array.size == 0:
        return np.empty((0, 4)), dtype
    if array.ndim != 2 or array.shape[1] != 4:
        raise ValueError(f"the boxes (xyxy) have the shape {array.shape}; they must be (N, 4): left, top, right, bottom")
    # A copy in any case: contiguous, aligned, and nobody else's.
    return np.array(array, dtype=np.float64, order="C"), dtype


def _with_ids(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """The type of rows that have an id among their numbers: in half precision, ids above 2048 would become equal."""
    return np.result_type(dtype, np.float32)


def _column(value: Any, what: str) -> NDArray[np.float64]:
    array = _numbers(value, what)
    if array.size == 0:
        return np.empty(0)
    if array.ndim != 1:
        raise ValueError(f"{what} has the shape {array.shape}; it must be (N,)")
    return np.array(array, dtype=np.float64)


def real_boxes(xyxy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Those that are boxes: detectors fill up a result of fixed length, with zeros for example."""
    xyxy = xyxy[np.isfinite(xyxy).all(axis=1)]
    return xyxy[(xyxy[:, :2] < xyxy[:, 2:]).all(axis=1)]


def doubt(xyxy: NDArray[np.float64], size: tuple[int, int]) -> str | None:
    """Why these boxes, of which there is one at least, are hardly in pixels of a picture of this size."""
    width, height = size
    left, top, right, bottom = xyxy.T
    if not ((right > 0) & (bottom > 0) & (left < width) & (top < height)).any():
        return f"all boxes lie outside the picture of {width}x{height} pixels: give pixels, and size as (width, height)"
    if xyxy.max() <= 1:
        return "no box reaches beyond the first pixel; these look like shares of the picture: give pixels"
    return None


def named(arrays: _core._Arrays) -> Boxes:
    """The arrays of the extension module with names."""
    xyxy, confidence, class_id, tracker_id, source = arrays
    return Boxes(xyxy, confidence, class_id, tracker_id, _SOURCES[source])
