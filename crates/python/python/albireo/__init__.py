"""Runs your video object detector only on the frames that need it, and tracks the objects in between.

    import albireo

    tracked = albireo.track("drive.mp4", detector)
    for frame in tracked:
        for box in frame.boxes:
            print(frame.number, box.tracker_id, box.xyxy)
    print(tracked)

or, in a loop of your own:

    skip = albireo.Skipper("expected-loss", threshold=0.3, size=(1280, 720))
    for n, image in enumerate(video):
        if skip.wants_detector(n):
            boxes = skip.update(detector(image))
        else:
            boxes = skip.predict()
    print(skip)

`help(albireo.track)` and `help(albireo.Skipper)` describe all settings and methods.
"""

from ._core import __version__
from .results import Box, Boxes, ColorOrder, Columns, Image
from .skipper import Skipper
from .tracking import Tracked, Tracking, track

__all__ = [
    "Box", "Boxes", "ColorOrder", "Columns", "Image", "Skipper", "Tracked", "Tracking", "__version__", "track"
]
