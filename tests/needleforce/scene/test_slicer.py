"""3D Slicer gets pose, force and ruptures."""

import json
import subprocess
import sys
import time

import numpy as np
import pytest

from needleforce.scene import SceneError, SlicerOutput
from tests.needleforce.scene.insertions import clearance, deviation, tick

pytestmark = pytest.mark.slow

RECEIVER = """
import json, sys, time, pyigtl
client = pyigtl.OpenIGTLinkClient("127.0.0.1", int(sys.argv[1]))
client.start()
received = {}
end_s = time.monotonic() + 20.0
print("ready", flush=True)
while time.monotonic() < end_s and "Rupture" not in received:
    for message in client.get_latest_messages():
        is_pose = message.device_name == "NeedleToReference"
        content = message.matrix.tolist() if is_pose else message.string
        received[message.device_name] = content
    time.sleep(0.005)
print(json.dumps(received), flush=True)
client.stop()
"""


def test_3d_slicer_gets_pose_force_and_ruptures():
    port = 18977
    pose = np.eye(4)
    pose[:3, 3] = 0.01, 0.02, 0.03
    state = {"deviation": deviation(), "clearances": (clearance(),)}
    with (
        SlicerOutput(port) as output,
        subprocess.Popen(
            [sys.executable, "-c", RECEIVER, str(port)],
            stdout=subprocess.PIPE,
            text=True,
        ) as receiver,
    ):
        assert receiver.stdout.readline().strip() == "ready"
        end_s = time.monotonic() + 20.0
        while not output.is_connected:
            assert time.monotonic() < end_s
            time.sleep(0.05)
        sent = 0
        for k in range(1000):
            rupture = 1 if k == 999 else None
            sent += output.put(tick(0.001 * k, 0.02, rupture=rupture, **state), pose)
            time.sleep(0.001)
        received = json.loads(receiver.communicate(timeout=30.0)[0])

    assert sent == pytest.approx(51, abs=1)
    # LPS metres become RAS millimetres.
    place_mm = np.array(received["NeedleToReference"])[:3, 3]
    assert np.allclose(place_mm, [-10.0, -20.0, 30.0], atol=1e-3)
    rupture, force, on_plan = (
        json.loads(received[name]) for name in ("Rupture", "Force", "Plan")
    )
    assert on_plan["verdict"] == "on plan"
    assert [
        *(rupture["depth_mm"], force["tip_force_N"], on_plan["to_target_m"]),
        on_plan["clearances"]["vein"]["ahead_m"],
    ] == pytest.approx([20.0, 0.2, 24.3e-3, 12e-3])


def test_slicer_is_updated_when_time_restarts_and_nan_is_null(monkeypatch):
    sent = []
    with SlicerOutput(18978) as output:
        monkeypatch.setattr(output, "_send", sent.append)
        times_s = (0.0, 0.01, 60.0, 60.01, 0.5, 0.51, 0.52)
        assert [output.put(tick(time_s), np.eye(4)) for time_s in times_s] == [
            1,
            0,
            1,
            0,
            1,
            0,
            1,
        ]
        assert output.put(tick(1.0, float("nan")), np.eye(4))
        force = json.loads(sent[-1].string, parse_constant=pytest.fail)
        assert force["force_N"] is None
        for port in (18978, 70000):
            with pytest.raises(SceneError, match=str(port)):
                SlicerOutput(port)
