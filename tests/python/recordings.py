"""Reads and writes MCAP files with PyPI's `mcap`, as other programs do. One request in JSON, one answer in JSON.

{"read": FILE}   by the file's index, decoding protobuf by the schemas in the file
{"rerun": FILE}   by the loader of `rerun-sdk`: what becomes of each topic
{"recover": FILE}   record by record until the file breaks off
{"write": FOLDER, "jpeg": BASE64, "rgb": BASE64, "size": [WIDTH, HEIGHT]}   pictures as Foxglove and ROS 2 write them
{"coco": FILE}   annotations by pycocotools
"""

import base64
import collections
import contextlib
import json
import math
import struct
import sys

from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.decoder import DecoderFactory


def decoded(schema, channel, message):
    if channel.message_encoding == "json":
        return json.loads(message.data)
    return DecoderFactory().decoder_for(channel.message_encoding, schema)(message.data)


def read(path):
    counts = collections.Counter()
    found = {"jpeg": 0, "lines": [], "texts": [], "states": [], "objects": [], "tau": [], "reasons": [], "detections": []}
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_summary().statistics.message_count > 0
        for schema, channel, message in reader.iter_messages():
            counts[channel.topic] += 1
            content = decoded(schema, channel, message)
            if schema.name == "foxglove.CompressedImage":
                found["jpeg"] += content.data.startswith(b"\xff\xd8") and content.format == "jpeg"
            elif schema.name == "foxglove.ImageAnnotations":
                found["lines"].append([[[point.x, point.y] for point in line.points] for line in content.points])
                found["texts"].append([text.text for text in content.texts])
            elif schema.name == "albireo.Figures":
                found["states"].append(content.state)
                found["objects"].append(list(content.objects))
                found["tau"].append(None if math.isnan(content.tau_max) else content.tau_max)
            elif schema.name == "albireo.Event":
                found["reasons"].append(content["reason"])
            elif schema.name == "albireo.Detections":
                found["detections"].append(content)
            if schema.encoding == "jsonschema":
                assert json.loads(schema.data)["type"] == "object"
    return {"counts": counts, **found}


def rerun(path):
    from rerun.chunk import McapReader

    found = {"pictures": 0, "states": [], "places": 0, "lines": []}
    for chunk in McapReader(path).stream():
        columns = chunk.to_record_batch().to_pydict()
        found["pictures"] += sum(bytes(row[0][:2]) == b"\xff\xd8" for row in columns.get("EncodedImage:blob", []) if row)
        found["places"] += sum(bool(row) for row in columns.get("GeoPoints:positions", []))
        found["states"] += [row[0]["state"] for row in columns.get("albireo.Figures:message", [])]
        found["lines"] += [len(row[0]["points"]) for row in columns.get("foxglove.ImageAnnotations:message", [])]
    return found


def recover(path):
    counts, topics, end = collections.Counter(), {}, None
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file).records:
                if type(record).__name__ == "Channel":
                    topics[record.id] = record.topic
                elif type(record).__name__ == "Message":
                    counts[topics[record.channel_id]] += 1
        except Exception as error:  # noqa: BLE001
            end = type(error).__name__
    return {"counts": counts, "end": end}


def cdr_text(text):
    return struct.pack("<I", len(text) + 1) + text.encode() + b"\0"


def padded(data, size=4):
    return data + bytes(-len(data) % size)


def cdr_header():
    return struct.pack("<iI", 1_700_000_000, 0) + padded(cdr_text("camera"))


def compressed_image(jpeg):
    body = cdr_header() + padded(cdr_text("jpeg")) + struct.pack("<I", len(jpeg)) + jpeg
    return b"\x00\x01\x00\x00" + body


def image(rgb, width, height):
    body = cdr_header() + struct.pack("<II", height, width) + cdr_text("rgb8") + b"\0"
    body = padded(body) + struct.pack("<II", 3 * width, len(rgb)) + rgb
    return b"\x00\x01\x00\x00" + body


def write(request):
    jpeg, rgb = base64.b64decode(request["jpeg"]), base64.b64decode(request["rgb"])
    in_json = {"timestamp": {"sec": 0, "nsec": 0}, "frame_id": "camera", "format": "jpeg", "data": request["jpeg"]}
    ros = "sensor_msgs/msg/"
    topics = {
        "/foxglove": ("foxglove.CompressedImage", "jsonschema", "json", json.dumps(in_json).encode()),
        "/ros/compressed": (ros + "CompressedImage", "ros2msg", "cdr", compressed_image(jpeg)),
        "/ros/image": (ros + "Image", "ros2msg", "cdr", image(rgb, *request["size"])),
        "/ros/cut": (ros + "Image", "ros2msg", "cdr", image(rgb, *request["size"])[:-1]),
        "/imu": (ros + "Imu", "ros2msg", "cdr", b"\x00\x01\x00\x00"),
    }
    for compression in CompressionType:
        writer = Writer(f"{request['write']}/{compression.name.lower()}.mcap", compression=compression)
        writer.start()
        channels = {}
        for topic, (name, encoding, of_messages, _) in topics.items():
            schema = writer.register_schema(name=name, encoding=encoding, data=b"{}")
            # Two senders on each topic, as when two files are joined.
            channels[topic] = [writer.register_channel(topic, of_messages, schema) for _ in range(2)]
        # Nothing keeps a sender of something else from a topic of pictures.
        schema = writer.register_schema(name=ros + "CameraInfo", encoding="ros2msg", data=b"{}")
        other = writer.register_channel("/ros/image", "cdr", schema)
        for frame in range(5):
            time = 1_700_000_000_000_000_000 + frame * 50_000_000
            for topic, (_, _, _, data) in topics.items():
                writer.add_message(channels[topic][frame % 2], log_time=time, publish_time=time, data=data)
            writer.add_message(other, log_time=time, publish_time=time, data=b"\x00\x01\x00\x00")
        writer.finish()
    return [compression.name.lower() for compression in CompressionType]


def coco(path):
    from pycocotools.coco import COCO

    with contextlib.redirect_stdout(sys.stderr):
        dataset = COCO(path)
    names = [category["name"] for category in dataset.loadCats(dataset.getCatIds())]
    boxes = [annotation["bbox"] for annotation in dataset.loadAnns(dataset.getAnnIds())]
    return {"images": len(dataset.getImgIds()), "names": names, "boxes": boxes}


request = json.load(sys.stdin)
if "read" in request:
    answer = read(request["read"])
elif "rerun" in request:
    answer = rerun(request["rerun"])
elif "recover" in request:
    answer = recover(request["recover"])
elif "write" in request:
    answer = write(request)
else:
    answer = coco(request["coco"])
json.dump(answer, sys.stdout)
