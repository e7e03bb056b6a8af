"""Judges tracks on MOTChallenge sequences with TrackEval, from their files, with the benchmark's own preprocessing.

Reads JSON from standard input: {"folder": F, "benchmark": B, "sequences": {NAME: FRAMES, ...}}. F/gt has the sequences in
the layout of MOTChallenge, F/tracks/ours one NAME.txt of results for each. Writes JSON: for each sequence in order
[HOTA, IDF1, boxes judged].
"""

import contextlib
import io
import json
import sys

import numpy

with contextlib.redirect_stdout(io.StringIO()):  # of data sets that it has no tools for
    from trackeval.datasets.mot_challenge_2d_box import MotChallenge2DBox
    from trackeval.metrics import HOTA, Identity


def main():
    request = json.load(sys.stdin)
    with contextlib.redirect_stdout(io.StringIO()):
        data = MotChallenge2DBox(
            {
                "GT_FOLDER": request["folder"] + "/gt",
                "TRACKERS_FOLDER": request["folder"] + "/tracks",
                "OUTPUT_FOLDER": request["folder"],
                "TRACKERS_TO_EVAL": ["ours"],
                "TRACKER_SUB_FOLDER": "",
                "BENCHMARK": request["benchmark"],
                "SEQ_INFO": request["sequences"],
                "SKIP_SPLIT_FOL": True,
                "PRINT_CONFIG": False,
            }
        )
        scores = []
        for name in request["sequences"]:
            raw = data.get_raw_seq_data("ours", name)
            judged = data.get_preprocessed_seq_data(raw, "pedestrian")
            hota = numpy.mean(HOTA().eval_sequence(judged)["HOTA"])
            idf1 = Identity().eval_sequence(judged)["IDF1"]
            scores.append([float(hota), float(idf1), int(judged["num_tracker_dets"])])
    json.dump(scores, sys.stdout)


main()
