"""Reads a recording with other people's readers, and compares what they find.

usage: read_recording.py FILE TICKS; prints "agreed" if all is as it should be.
"""

import json
import math
import struct
import sys

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from pathlib import Path

path, ticks = sys.argv[1], int(sys.argv[2])
TICK_TOPICS = ["odometry", "raw_command", "command", "tracking_error"]
ROS_TOPICS = ["/odom", "/truth", "/cmd", "/tracking_error"]
FORMATS = {"u32": "<I", "u64": "<Q", "f64": "<d"}


def fields(table, data):
    return {
        f["name"]: struct.unpack_from(FORMATS[f["kind"]], data, f["offset"])[0]
        for f in table["fields"]
    }


own = {topic: [] for topic in TICK_TOPICS}
with open(path, "rb") as file:
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    counts = {
        channel.topic: summary.statistics.channel_message_counts.get(id, 0)
        for id, channel in summary.channels.items()
    }
    for topic in ROS_TOPICS + ["/tf"] + [f"/pathtune/{topic}" for topic in TICK_TOPICS]:
        assert counts[topic] == ticks, (topic, counts[topic], ticks)
    for schema, channel, message in reader.iter_messages():
        name = channel.topic.removeprefix("/pathtune/")
        # The tools of ROS 2 take a file only if all of it is CDR with a schema.
        assert channel.message_encoding == "cdr" and schema.encoding == "ros2msg", channel
        assert "reliability" in channel.metadata["offered_qos_profiles"], channel
        if channel.topic.startswith("/pathtune/") and name in own:
            layout = json.loads(channel.metadata["layout"])
            header, element = layout["header"], layout["element"]
            # After the encapsulation and the length.
            data = message.data[8:]
            assert len(data) == header["bytes"] + element["bytes"]
            own[name].append(
                (fields(header, data), fields(element, data[header["bytes"] :]))
            )
    names = {attachment.name for attachment in reader.iter_attachments()}
    assert {"config.toml", "launch.toml"} <= names, names
    metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert metadata["pathtune.end"]["gaps"] == "0", metadata
    assert int(metadata["pathtune"]["wall_clock_origin_ns"]) > 1.6e18, metadata
    assert metadata["rosbag2"]["serialized_metadata"].startswith("version: 8\n"), metadata


def yaw_of(q):
    return math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))


def apart(a, b):
    return abs(math.remainder(a - b, 2 * math.pi))


def check(messages, reader_name):
    counts = dict.fromkeys(ROS_TOPICS, 0)
    for topic, message in messages:
        index = counts[topic]
        counts[topic] += 1
        seen = own["odometry"][index][1]
        stamp = message.header.stamp
        # The drives lie end to end.
        assert stamp.sec * 1_000_000_000 + stamp.nanosec == index * 10_000_000
        if topic in ("/odom", "/truth"):
            prefix = "measured" if topic == "/odom" else "truth"
            pose, twist = message.pose.pose, message.twist.twist
            assert pose.position.x == seen[f"{prefix}.x_m"]
            assert pose.position.y == seen[f"{prefix}.y_m"]
            assert apart(yaw_of(pose.orientation), seen[f"{prefix}.yaw_rad"]) < 1e-9
            assert twist.linear.x == seen["speed_mps"]
            assert twist.angular.z == seen["yaw_rate_radps"]
        elif topic == "/cmd":
            given = own["command"][index][1]
            single = lambda number: struct.unpack("<f", struct.pack("<f", number))[0]
            assert message.drive.speed == single(given["speed_mps"])
            assert message.drive.steering_angle == single(given["steering_rad"])
        else:
            error = own["tracking_error"][index][1]
            assert message.vector.x == error["along_track_m"]
            assert message.vector.y == error["cross_track_m"]
            assert message.vector.z == error["heading_rad"]
    assert counts == dict.fromkeys(ROS_TOPICS, ticks), (reader_name, counts)


with open(path, "rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    check(
        ((m.channel.topic, m.decoded_message) for m in reader.iter_decoded_messages(topics=ROS_TOPICS)),
        "mcap-ros2-support",
    )
    told = [
        m.decoded_message.status[0].message
        for m in reader.iter_decoded_messages(topics=["/diagnostics"])
    ]
    assert any(text.startswith("starts") for text in told), told
    assert any(text.startswith("ended") for text in told), told

with AnyReader([Path(path)]) as reader:
    one = {it.topic: it for it in reader.connections}
    transforms = [
        reader.deserialize(data, connection.msgtype).transforms
        for connection, _, data in reader.messages([one["/tf"]])
    ]
    for index, (transform,) in enumerate(transforms):
        seen = own["odometry"][index][1]
        assert transform.header.frame_id == "map" and transform.child_frame_id == "tracked_point"
        assert transform.transform.translation.x == seen["measured.x_m"]
        assert apart(yaw_of(transform.transform.rotation), seen["measured.yaw_rad"]) < 1e-9
    ((_, _, data),) = reader.messages([one["/path"]])
    poses = [it.pose for it in reader.deserialize(data, one["/path"].msgtype).poses]
    assert len(poses) > 2000 and yaw_of(poses[0].orientation) == 0, len(poses)
    (qos,) = one["/path"].ext.offered_qos_profiles
    assert qos.durability.name == "TRANSIENT_LOCAL" and qos.reliability.name == "RELIABLE", qos
    # Our own messages have a type as well.
    connection, _, data = next(reader.messages([one["/pathtune/odometry"]]))
    assert len(reader.deserialize(data, connection.msgtype).data) == len(data) - 8
    wanted = [it for it in reader.connections if it.topic in ROS_TOPICS]
    check(
        (
            (connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, _, data in reader.messages(wanted)
        ),
        "rosbags",
    )
print("agreed on", ticks, "ticks")
