"""Errors of anatomy: one base; each of the others is also a standard exception."""


class AnatomyError(Exception):
    """Base of all errors of this package."""


class VolumeError(AnatomyError, ValueError):
    """A volume or a segmentation that cannot be read, or that contradicts itself or another."""


class StructureError(AnatomyError, KeyError):
    """A structure that the segmentation does not have, or that is empty."""

    def __str__(self) -> str:
        """The message itself; a KeyError would put it in quotes."""
        return str(self.args[0])


class PathError(AnatomyError, ValueError):
    """Entry or target of a needle that cannot be."""


class RegistrationError(AnatomyError, ValueError):
    """A registration that is refused; the message says why and what would help."""


class PlanError(AnatomyError, ValueError):
    """A plan that cannot be matched with ruptures."""
