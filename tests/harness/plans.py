"""Plans as they are on the wire."""

from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
PATH = "nav_msgs/msg/Path"


def plan(*points, frame="map"):
    """A `nav_msgs/msg/Path` through points (x, y), serialized."""
    header = STORE.types["std_msgs/msg/Header"]
    stamp = STORE.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    place, turn, pose, stamped = (
        STORE.types[f"geometry_msgs/msg/{name}"]
        for name in ("Point", "Quaternion", "Pose", "PoseStamped")
    )
    here = header(stamp=stamp, frame_id=frame)
    poses = [
        stamped(
            header=here,
            pose=pose(
                position=place(x=float(x), y=float(y), z=0.0),
                orientation=turn(x=0.0, y=0.0, z=0.0, w=1.0),
            ),
        )
        for x, y in points
    ]
    return bytes(STORE.serialize_cdr(STORE.types[PATH](header=here, poses=poses), PATH))
