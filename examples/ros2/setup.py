"""The ROS package needleforce: `ros2 run needleforce node`, and its launch file.

It has no code of its own: the node is that of the Python package needleforce, which pip
installs. Its name for Python is another, so that neither hides the other.
"""

from setuptools import setup

SHARE = "share/needleforce"

setup(
    name="needleforce_ros",
    version="0.2.0",
    packages=[],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/needleforce"]),
        (SHARE, ["package.xml", "parameters.yaml", "needleforce.rviz"]),
        (f"{SHARE}/launch", ["needleforce.launch.py"]),
    ],
    install_requires=["setuptools"],
    entry_points={"console_scripts": ["node = needleforce.cli:run_ros2_node"]},
)
