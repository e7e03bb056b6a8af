"""A ROS 2 camera and a reader of boxes, over Zenoh, without ROS 2: messages and type hashes are those of rosbags.

Usage: ros2.py ENDPOINT TOPIC BOXES PICTURE

Publishes PICTURE (PPM) once in every encoding on TOPIC, in turn with the keys of Jazzy, of Humble and of
zenoh-bridge-ros2dds, and reads the answers on the topic BOXES. Prints `ready`, then a JSON line for each answer, and at last
the liveliness tokens.
"""

import json
import queue
import sys

import numpy
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

# ros-perception/vision_msgs, from 4.0 on.
VISION = {
    "Detection2DArray": "std_msgs/Header header\nDetection2D[] detections",
    "Detection2D": "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox2D bbox\nstring id",
    "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "Point2D": "float64 x\nfloat64 y",
    "ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "ObjectHypothesis": "string class_id\nfloat64 score",
}
ARRAY = "vision_msgs/msg/Detection2DArray"
IMAGE = "sensor_msgs/msg/Image"


def typestore():
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {}
    for name, text in VISION.items():
        types.update(get_types_from_msg(text, f"vision_msgs/msg/{name}"))
    store.register({name: fields for name, fields in types.items() if name not in store.fielddefs})
    return store


def keys(store, topic, message):
    """The keys of a topic: of Jazzy and later, of Humble, and of the bridge."""
    package, _, name = message.split("/")
    of_type = f"0{topic}/{package}::msg::dds_::{name}_"
    return [f"{of_type}/{store.hash_rihs01(message)}", f"{of_type}/TypeHashNotSupported", topic[1:]]


def encodings(picture):
    """The picture in the encodings of usb_cam and camera_ros: name, bytes per row, data."""
    height, width, _ = picture.shape
    r, g, b = (picture[:, :, channel].astype(float) for channel in range(3))
    luma = 0.299 * r + 0.587 * g + 0.114 * b
    y = (16 + luma * 219 / 255).round().astype(numpy.uint8)
    cb = (128 + (b - luma) / 1.772 * 224 / 255).round().astype(numpy.uint8)
    cr = (128 + (r - luma) / 1.402 * 224 / 255).round().astype(numpy.uint8)
    packed = numpy.empty((height, width * 2), numpy.uint8)
    packed[:, 0::2] = y
    packed[:, 1::4], packed[:, 3::4] = cb[:, 0::2], cr[:, 0::2]
    swapped = numpy.empty_like(packed)
    swapped[:, 0::2], swapped[:, 1::2] = packed[:, 1::2], packed[:, 0::2]

    def semi_planar(first, second, share):
        chroma = numpy.stack([first[::share, ::share], second[::share, ::share]], axis=-1)
        return y.tobytes() + chroma.tobytes()

    def bayer(pattern):
        channels = {"r": 0, "g": 1, "b": 2}
        mosaic = numpy.empty((height, width), numpy.uint8)
        for place, colour in enumerate(pattern):
            row, column = divmod(place, 2)
            mosaic[row::2, column::2] = picture[row::2, column::2, channels[colour]]
        return mosaic

    yield "rgb8", 3 * width, picture.tobytes()
    yield "bgr8", 3 * width, picture[:, :, ::-1].tobytes()
    yield "bgra8", 4 * width, numpy.dstack([picture[:, :, ::-1], numpy.full_like(y, 9)]).tobytes()
    yield "yuv422_yuy2", 2 * width, packed.tobytes()
    yield "yuyv", 2 * width, packed.tobytes()
    yield "yuv422", 2 * width, swapped.tobytes()
    yield "uyvy", 2 * width, swapped.tobytes()
    yield "nv12", width, semi_planar(cb, cr, 2)
    yield "nv21", width, semi_planar(cr, cb, 2)
    yield "nv24", width, semi_planar(cb, cr, 1)
    for pattern in ["rggb", "bggr", "gbrg", "grbg"]:
        mosaic = bayer(pattern)
        # Rows are padded, as cameras align them.
        padded = numpy.pad(mosaic, ((0, 0), (0, 32)))
        yield f"bayer_{pattern}8", width + 32, padded.tobytes()
        yield f"bayer_{pattern}16", 2 * width, (mosaic.astype("<u2") << 4).tobytes()


def read_ppm(path):
    with open(path, "rb") as file:
        magic, size, depth, data = file.read().split(b"\n", 3)
    assert (magic, depth) == (b"P6", b"255")
    width, height = map(int, size.split())
    return numpy.frombuffer(data, numpy.uint8).reshape(height, width, 3)


def answer(store, sample):
    array = store.deserialize_cdr(bytes(sample.payload), ARRAY)
    attachment = bytes(sample.attachment)
    number, time_ns = numpy.frombuffer(attachment[:16], "<i8")
    stamp = array.header.stamp
    return {
        "frame_id": array.header.frame_id,
        "t_ns": stamp.sec * 1_000_000_000 + stamp.nanosec,
        "number": int(number),
        "sent_ns": int(time_ns),
        "gid": attachment[16:].hex(),
        "boxes": [
            {
                "class": found.results[0].hypothesis.class_id,
                "score": found.results[0].hypothesis.score,
                "box": [found.bbox.center.position.x, found.bbox.center.position.y, found.bbox.size_x, found.bbox.size_y],
                "id": found.id,
                "same_header": found.header == array.header,
            }
            for found in array.detections
        ],
    }


def main():
    endpoint, topic, boxes, path = sys.argv[1:]
    store, picture = typestore(), read_ppm(path)
    height, width, _ = picture.shape
    Header, Time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"client"')
    configuration.insert_json5("connect/endpoints", json.dumps([endpoint]))
    configuration.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(configuration) as session:
        arrived = queue.Queue()
        listening = [
            session.declare_subscriber(key, zenoh.handlers.Callback(lambda sample: arrived.put(sample)))
            for key in keys(store, boxes, ARRAY)
        ]
        sending = [session.declare_publisher(key) for key in keys(store, topic, IMAGE)]
        print("ready", flush=True)
        sys.stdin.readline()
        for number, (name, step, data) in enumerate(encodings(picture)):
            header = Header(stamp=Time(sec=1_700_000_000 + number, nanosec=number), frame_id="camera_link")
            pixels = numpy.frombuffer(data, numpy.uint8)
            image = store.types[IMAGE](header, height, width, name, 0, step, pixels)
            sending[number % 3].put(bytes(store.serialize_cdr(image, IMAGE)))
            answers = [arrived.get(timeout=300) for _ in listening]
            found = [answer(store, sample) for sample in answers]
            print(json.dumps({"encoding": name, "keys": sorted(str(sample.key_expr) for sample in answers), "answers": found}), flush=True)
        tokens = session.liveliness().get("@ros2_lv/0/**")
        print(json.dumps(sorted(str(reply.ok.key_expr) for reply in tokens)), flush=True)


main()
