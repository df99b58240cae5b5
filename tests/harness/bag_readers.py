"""Two readers of a bag that know nothing of each other, nor of what wrote it."""

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore


def with_rosbags(bag):
    """Return topic, time [ns] and message of all that rosbags finds in a bag."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(bag) as reader:
        return [
            (connection.topic, time, store.deserialize_cdr(data, connection.msgtype))
            for connection, time, data in reader.messages()
        ]


def with_mcap(bag):
    """Return topic, time [ns] and message of all that the MCAP library finds in a bag."""
    with (bag / f"{bag.name}.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, message.log_time, decoded)
            for _, channel, message, decoded in reader.iter_decoded_messages()
        ]


READERS = (with_rosbags, with_mcap)
