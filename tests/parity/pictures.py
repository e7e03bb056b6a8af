"""The pictures to compare on: frames of real clips, a frame of the demonstration's road, and noise."""

import pathlib
import subprocess
import tarfile

import cv2
import numpy

ROAD = pathlib.Path(__file__).resolve().parents[2] / "demo/road.tar"
CLIPS = [
    ("highway_two_cars.mp4", 60),
    ("highway_busy.mp4", 100),
    ("highway_empty_then_car.mp4", 60),
    ("fixed_topdown_cars.mp4", 200),
]


def letterboxed(picture, side):
    """Centres `picture` in a grey square with OpenCV, so that it needs no further resizing."""
    rows, columns = picture.shape[:2]
    scale = min(side / rows, side / columns)
    size = round(columns * scale), round(rows * scale)
    resized = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
    square = numpy.full((side, side, 3), 114, numpy.uint8)
    left, top = (side - size[0]) // 2, (side - size[1]) // 2
    square[top : top + size[1], left : left + size[0]] = resized
    return square


def sources(shared, folder):
    """Returns picture files in their original sizes, PNG and JPEG."""
    folder = pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for clip, number in CLIPS:
        file = folder / f"{pathlib.Path(clip).stem}.png"
        command = ["ffmpeg", "-v", "error", "-y", "-i", pathlib.Path(shared) / "media" / clip]
        command += ["-vf", f"select=eq(n\\,{number})", "-frames:v", "1", file]
        subprocess.run(command, check=True)
        files.append(file)
    with tarfile.open(ROAD) as road:
        road.extract("busy/0040.jpg", folder, filter="data")
    files.append(folder / "busy/0040.jpg")
    generator = numpy.random.default_rng(7)
    # Grains of a few pixels: noise of single pixels resembles nothing that a network sees.
    noise = cv2.GaussianBlur(generator.integers(0, 256, (333, 517, 3), numpy.uint8), (0, 0), 2)
    noise = cv2.normalize(noise, None, 0, 255, cv2.NORM_MINMAX)
    file = folder / "noise_517x333.png"
    cv2.imwrite(str(file), noise)
    files.append(file)
    # A smooth picture smaller than the networks' input, so that it is enlarged.
    small = cv2.GaussianBlur(generator.integers(0, 256, (90, 160, 3), numpy.uint8), (0, 0), 3)
    file = folder / "small_160x90.png"
    cv2.imwrite(str(file), cv2.normalize(small, None, 0, 255, cv2.NORM_MINMAX))
    files.append(file)
    return files


def exact(files, side, folder):
    """Saves the pictures losslessly as squares of `side`, so that nothing is left to resize."""
    folder = pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    squares = []
    for file in files:
        square = folder / f"{file.stem}_{side}.png"
        cv2.imwrite(str(square), letterboxed(cv2.imread(str(file)), side))
        squares.append(square)
    return squares
