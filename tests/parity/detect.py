"""Runs `albireo detect`."""

import json
import pathlib
import subprocess

import numpy


def detect(program, model, files, folder, confidence, more=()):
    """Returns the recognised head and, for each file, the detections as rows of x1, y1, x2, y2, score, class, and the
    model's input as planes of float32."""
    command = [program, "detect", model, *files, "--json", "--all-classes", "--write-input", folder]
    command += ["--confidence", confidence, "--threads", 1, *more]
    run = subprocess.run(list(map(str, command)), check=True, stdout=subprocess.PIPE, text=True)
    answers = [json.loads(line) for line in run.stdout.splitlines()]
    keys = ("x1", "y1", "x2", "y2", "confidence", "class")
    found = []
    for answer in answers[1:]:
        rows = [[one[key] for key in keys] for one in answer["detections"]]
        file = pathlib.Path(folder) / (pathlib.Path(answer["picture"]).name + ".f32")
        tensor = numpy.fromfile(file, "<f4").reshape(answers[0]["input"][1:])
        found.append((numpy.array(rows, numpy.float64).reshape(-1, 6), tensor))
    return answers[0]["head"], found
