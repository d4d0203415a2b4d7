"""Estimates of a session, plans and CTs as the scene shows them."""

from types import SimpleNamespace

import numpy as np

from needleforce import PlanDeviation
from needleforce.anatomy import Grid, NeedleClearance, PlanState, Volume
from needleforce.scene import Moment, PlanScene

HOME = np.array([0.0, 0.5, 0.0, -1.2, 0.0, 1.0, 0.0])


def tick(time_s, depth_m=0.0, *, rupture=None, retracted=None, status="ok", **more):
    """What a session says; a rupture is the number of its layer."""
    identification = SimpleNamespace(
        tip_force_N=10.0 * depth_m,
        tip_force_std_N=0.1,
        shaft_friction_N=0.2,
        enhanced_force_N=15.0 * depth_m,
        layer=1,
        rupture=rupture and at_layer(rupture, depth_m),
        retracted=retracted and at_layer(retracted, depth_m),
        hard_contact=None,
        identified_layer=None,
    )
    values = {
        **{"depth_in_tissue_m": None, "plan": None, "deviation": None},
        **{"clearances": (), "plan_events": (), "warnings": ()},
    }
    return SimpleNamespace(
        time_s=time_s,
        depth_m=depth_m,
        speed_m_s=0.0,
        wrench=SimpleNamespace(axial=20.0 * depth_m, axial_std=0.05, message=""),
        identification=identification,
        status=SimpleNamespace(value=status),
        **(values | more),
    )


def at_layer(layer, depth_m):
    return SimpleNamespace(
        layer=layer,
        depth_m=depth_m,
        probability=0.9,
        time_s=0.0,
        force_N=1.0,
        speed_m_s=0.0,
        alarm_s=0.0,
    )


def moment(time_s, depth_m=0.0, q=HOME, **more):
    return Moment(np.array(q), tick(time_s, depth_m, **more))


def insertion(count=200):
    """One row every 50 ms to 20 mm, with a rupture at 12 mm and 6 s."""
    return [
        moment(0.05 * k, 1e-4 * k, rupture=1 if k == 120 else None)
        for k in range(count)
    ]


def deviation(**more):
    """A needle on its plan, 24.3 mm before the target."""
    values = {
        "entry_m": 1.2e-3,
        "entry_std_m": 0.3e-3,
        "tip_m": 2.0e-3,
        "tip_std_m": 0.5e-3,
        "angle_rad": 0.02,
        "angle_std_rad": 0.005,
        "depth_m": 0.02,
        "to_target_m": 24.3e-3,
        "to_target_std_m": 0.4e-3,
        "is_off_plan": False,
        "is_past_target": False,
        "is_doubtful": False,
    }
    return PlanDeviation(**(values | more))


def clearance(distance_m=12e-3, place_m=(0.0, 0.0, 0.0), needed_m=3e-3, name="vein"):
    return NeedleClearance(
        0, name, 1.0, distance_m, 0.6e-3, needed_m, False, *map(float, place_m)
    )


def planned(layer, next_m, matched=-1):
    """What plan and ruptures say."""
    names = ["fat", "liver", "rib", ""]
    into = names[matched] if matched >= 0 else "a false alarm"
    name = names[layer] if layer >= 0 else "outside"
    return PlanState(
        *(layer, name, 0.93, 2e-3, 0.4e-3),
        *(names[layer + 1], next_m, 0.5e-3),
        *(matched, into, 0.97, False),
    )


def plan():
    """Two boxes under the needle, and the path through them."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    triangles = [[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 4, 5], [0, 5, 1]]
    surfaces = [
        SimpleNamespace(
            name=name,
            colour=colour,
            vertices_m=0.05 * corners + [-0.6, 0.0, height_m],
            triangles=np.array(triangles),
        )
        for name, colour, height_m in (
            ("liver", (0.6, 0.2, 0.2), 0.2),
            ("rib", (0.9, 0.9, 0.9), 0.1),
        )
    ]
    layers = [
        SimpleNamespace(name="fat", exit_m=0.02, is_obstacle=False),
        SimpleNamespace(name="liver", exit_m=0.05, is_obstacle=False),
        SimpleNamespace(name="rib", exit_m=0.08, is_obstacle=True),
    ]
    return PlanScene(
        surfaces,
        layers,
        entry_m=np.array([-0.6, 0.0, 0.3]),
        target_m=np.array([-0.6, 0.0, 0.2]),
        watched=("rib", "vein"),
    )


def scanned(bright_m, tip_m, axis):
    """A plan with a CT of air and one bright place; a needle lies as from the front.

    Args:
        bright_m: Place in the patient.
        tip_m: Where the patient's origin lies in the robot's base.
        axis: Where his back lies.
    """
    grid = Grid((61, 61, 61), np.full(3, -0.06), 2e-3 * np.eye(3))
    values = np.full(grid.shape, -1000, np.int16)
    i, j, k = np.rint(grid.indices(bright_m)).astype(int)
    values[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2] = 1000
    left = np.cross(axis, [0.0, 1.0, 0.0]) / np.hypot(axis[0], axis[2])
    return PlanScene(
        layers=plan().layers,
        entry_m=np.array([0.0, -0.04, 0.0]),
        target_m=np.array([0.0, -0.0099, 0.0]),
        rotation=np.column_stack([left, axis, np.cross(left, axis)]),
        translation_m=tip_m,
        scan=Volume(values, grid),
    )
