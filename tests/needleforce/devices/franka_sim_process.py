"""An FR3 of franky-sim, written by others, in a process of its own.

It speaks the protocol of libfranka, version 10, on loopback. A function for
`emulators.Emulator`.
"""

import threading

HOST = "127.0.0.7"
"""Of loopback, where no other test emulates a Franka."""


def emulate_fr3(pipe, host=HOST):
    """Simulate an FR3 until something comes through the pipe."""
    import franky_sim
    from franky_sim.mujoco_simulator import MujocoSimulator

    with MujocoSimulator(enable_visualization=False) as simulator:
        robot = simulator.add_robot()
        with franky_sim.SimulationServer(simulator, hostname_candidates=[host]) as sim:
            threading.Thread(target=sim.run_forever, daemon=True).start()
            pipe.send({"address": robot.hostname})
            pipe.poll(None)
            return {}
