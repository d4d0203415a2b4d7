"""Where one layer gives way to the next: depth, force released, travel of the release."""

from dataclasses import dataclass

from groundtruth.layer import Layer
from groundtruth.membrane import Membrane


@dataclass(frozen=True, slots=True, kw_only=True)
class Interface:
    """The boundary above a layer, or behind the last one.

    A membrane at a boundary backs up the tissue above it: the tip force of the layer above is
    held while the membrane is pushed in, and both are released together at the puncture. So each
    boundary gives one rupture.

    Attributes:
        depth_m: Where it lies in undeformed tissue.
        onset_m: Depth of the tip at which it begins to give way.
        release_m: Travel over which the force is then released.
        drop_N: Force released, tissue not relaxed; zero at a bare surface.
        membrane: The membrane to puncture there, if any.
    """

    depth_m: float
    onset_m: float
    release_m: float
    drop_N: float
    membrane: Membrane | None

    def released(self, deepest_m: float) -> float:
        """Share of the force released, 0 to 1, once the tip has been as deep as `deepest_m`.

        A crack starts fast and dies out: 1 - (1 - s)², s the travelled share of `release_m`.
        """
        travelled = deepest_m - self.onset_m
        if travelled <= 0.0:
            return 0.0
        if travelled >= self.release_m:
            return 1.0
        rest = 1.0 - travelled / self.release_m
        return 1.0 - rest * rest


def interfaces(layers: tuple[Layer, ...]) -> tuple[Interface, ...]:
    """All boundaries of a stack, from the surface to the exit: one more than layers.

    Args:
        layers: The layers, first the one the needle meets first; none gives no boundary.
    """
    found: list[Interface] = []
    depth = 0.0
    for above, below in zip((None, *layers), (*layers, None), strict=True):
        membrane = None if below is None else below.membrane
        if above is None and below is None:
            break
        drop = 0.0 if above is None else above.exit_force_N
        release = below.release_m if above is None and below is not None else 0.0
        release = above.release_m if above is not None else release
        if membrane is not None:
            drop += membrane.puncture_N
            release = membrane.release_m
        onset = depth + (0.0 if membrane is None else membrane.indentation_m)
        found.append(
            Interface(
                depth_m=depth, onset_m=onset, release_m=release, drop_N=drop, membrane=membrane
            )
        )
        if below is not None:
            depth += below.thickness_m
    return tuple(found)
