"""Runs your video object detector only on the frames that need it, and tracks the objects in between.

    import albireo

    skip = albireo.Skipper("expected-loss", threshold=0.3, size=(1280, 720))
    for n, frame in enumerate(video):
        if skip.wants_detector(n):
            boxes = skip.update(model(frame))
        else:
            boxes = skip.predict()
    print(skip)

`help(albireo.Skipper)` describes all settings and methods; `albireo.track` runs the loop for you.
"""

from ._core import __version__
from .results import Boxes
from .skipper import Skipper
from .tracking import Tracked, track

__all__ = ["Boxes", "Skipper", "Tracked", "__version__", "track"]
