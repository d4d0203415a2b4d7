"""The order of joints in a recording that names them."""

from typing import NamedTuple

from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.errors import ColumnError
from needleforce.recordings.joint_names import choose_match, match_joints


class JointOrder(NamedTuple):
    """In which order the joints of a column, or of a topic, are read.

    Attributes:
        joints: Their names, in order.
        notes: What was assumed, one sentence each.
    """

    joints: tuple[str, ...]
    notes: tuple[str, ...] = ()


def order_joints(
    name: str, joints: tuple[str, ...], request: ChannelRequest
) -> JointOrder:
    """Return the order of joints: the mapping's, the robot's, or the recording's.

    Args:
        name: Of the topic or column, for messages.
        joints: That the recording names, in its order; none if it names none.
        request: In which order the robot has them.

    Raises:
        ColumnError: The recording lacks a joint of the mapping, or has joints of
            several arms that would fit.
    """
    if not joints:
        return JointOrder(())

    mapping = request.mapping
    missing = [joint for joint in mapping.joint_order if joint not in joints]
    if missing:
        raise ColumnError(
            f"joints of the mapping that {name} does not have: "
            f"{', '.join(missing)}; it has: {', '.join(joints)}"
        )

    order = mapping.joint_order or request.joints
    if not order:
        return JointOrder(joints)

    matches = match_joints(joints, order)
    chosen = choose_match(matches, mapping.joint_pattern, name)
    if chosen is not None:
        note = (
            f"{name}: the joints {chosen.names[0]}, ... ({chosen.pattern}) were taken "
            f"for the robot's {order[0]}, ..."
        )
        is_equal = chosen.names == tuple(order)
        return JointOrder(chosen.names, () if is_equal else (note,))

    note = (
        f"{name} has the joints {', '.join(joints)}, the robot {', '.join(order)}; "
        "the order of the recording was kept, name another one with joints in the "
        "mapping"
    )
    return JointOrder(joints, (note,))
