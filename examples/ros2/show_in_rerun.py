"""Show a bag of `needleforce simulate` or `record`, and its layers, in Rerun.

needleforce simulate gel-25-constant -o insertion.mcap
needleforce force insertion.mcap -o forces.mcap
needleforce identify forces.mcap -o layers.mcap
python show_in_rerun.py insertion.mcap forces.mcap layers.mcap   # pip install rerun-sdk
"""

import sys

import rerun as rr
from mcap.reader import make_reader

from needleforce.recordings.writers import standard_types

M_TO_RADIUS = 0.006


def show(topic, kind, message):
    if kind == "tf2_msgs/msg/TFMessage":
        origins = [item.transform.translation for item in message.transforms]
        points = [(origin.x, origin.y, origin.z) for origin in origins]
        names = [item.child_frame_id for item in message.transforms]
        rr.log("arm/links", rr.LineStrips3D([points], radii=M_TO_RADIUS))
        rr.log("arm/frames", rr.Points3D(points, labels=names, radii=M_TO_RADIUS))
    elif kind == "std_msgs/msg/Float64":
        rr.log(topic, rr.Scalars(message.data))
    elif kind == "geometry_msgs/msg/WrenchStamped":
        force = message.wrench.force
        rr.log(f"{topic}/force", rr.Scalars([force.x, force.y, force.z]))


rr.init("needleforce", spawn="--save" not in sys.argv)
if "--save" in sys.argv:
    rr.save("insertion.rrd")
for path in sys.argv[1:]:
    if path == "--save":
        continue
    with open(path, "rb") as stream:
        for schema, channel, record in make_reader(stream).iter_messages():
            rr.set_time("time", timestamp=1e-9 * record.log_time)
            message = standard_types().deserialize_cdr(record.data, schema.name)
            show(channel.topic, schema.name, message)
