"""The optional parts of an installation, named by what a user does with them."""

PACKAGE = "needleforce"
"""Name under which all of this is installed."""

EXTRAS = {
    "demo": "the simulated arm; figures and report pages",
    "robots": "descriptions of the Franka Panda, UR3 to UR10, xArm 7",
    "recordings": "Parquet files and ROS 2 bags",
    "patient": "CT and segmentations, planned layers, registration",
    "scene": "the 3-D scene in a browser, with the patient in it",
    "slicer": "the needle shown live in 3D Slicer",
    "devices": "haptic device, KUKA iiwa, Franka and UR arms",
    "ros2": "nothing: the ROS 2 node takes the rclpy of your own ROS 2",
    "cluster": "benchmark campaigns on several machines",
    "docs": "building the documentation",
}
"""What each extra of a user adds, by its name in ``pip install 'needleforce[NAME]'``.

Those of developers (``bench``, ``test``, ``dev``) are not listed.
"""

EXTRA_OF_MODULE = {
    "mujoco": "demo",
    "matplotlib": "demo",
    "jinja2": "demo",
    "markupsafe": "demo",
    "example_robot_data": "robots",
    "pyarrow": "recordings",
    "rosbags": "recordings",
    "mcap": "recordings",
    "SimpleITK": "patient",
    "skimage": "patient",
    "manifold3d": "patient",
    "trimesh": "patient",
    "igl": "patient",
    "highdicom": "patient",
    "nibabel": "patient",
    "pydicom": "patient",
    "viser": "scene",
    "PIL": "scene",
    "yourdfpy": "scene",
    "pyigtl": "slicer",
    "websockets": "devices",
    "google": "devices",
    "franky": "devices",
    "rtde_receive": "devices",
    "rtde_control": "devices",
    "distributed": "cluster",
    "sphinx": "docs",
}
"""The extra that brings a module which may be missing."""


def install_command(extra: str) -> str:
    """Return the shell command that installs an extra of `EXTRAS`."""
    return f"pip install '{PACKAGE}[{extra}]'"


def extra_of(name: str | None) -> str | None:
    """Return the extra that brings a module, None for a module that no extra brings.

    Args:
        name: Its dotted name.
    """
    return EXTRA_OF_MODULE.get((name or "").partition(".")[0])
