"""The shapes of an arm, from its description; what cannot be read is left out."""

from functools import partial
from pathlib import Path
from typing import Any, NamedTuple


class ArmShapes(NamedTuple):
    """The shapes of an arm.

    Attributes:
        urdf: The description with its meshes, of yourdfpy.
        unread: Names of the meshes that could not be read, each once.
    """

    urdf: Any
    unread: tuple[str, ...]


def load_shapes(urdf_path: Path) -> ArmShapes:
    """Load the shapes of an arm as far as they can be read."""
    import yourdfpy

    find = partial(yourdfpy.filename_handler_magic, dir=urdf_path.parent)
    plain = yourdfpy.URDF.load(
        urdf_path, build_scene_graph=False, load_meshes=False, filename_handler=find
    )
    build = partial(yourdfpy.URDF, plain.robot, filename_handler=find)
    try:
        return ArmShapes(build(), ())
    except Exception:
        unread = _leave_unread_out(plain.robot, find)
    return ArmShapes(build(), unread)


def _leave_unread_out(robot: Any, find: Any) -> tuple[str, ...]:
    """Take the shapes whose mesh cannot be read from a description; return its name."""
    unread: dict[str, None] = {}
    for link in robot.links:
        kept = []
        for visual in link.visuals:
            mesh = None if visual.geometry is None else visual.geometry.mesh
            if mesh is None or _is_readable(find(fname=mesh.filename)):
                kept.append(visual)
            else:
                unread[mesh.filename] = None
        link.visuals = kept
    return tuple(unread)


def _is_readable(path: str) -> bool:
    """Return whether a mesh can be read; yourdfpy leaves out what is not there."""
    import trimesh

    if not Path(path).is_file():
        return True
    try:
        trimesh.load(path, ignore_broken=True, force="scene")
    except Exception:
        return False
    return True
