"""What hangs on the flange: a rigid body, or a needle behind a force/torque sensor.

The inertial parameters of one rigid body are ten numbers in kg, kg m and kg m^2, in
Pinocchio's order, linear in every torque the body causes:

    phi = (m, m c_x, m c_y, m c_z, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz),

with c the centre of mass and I the inertia about the frame origin. A body with
non-negative density exists for phi exactly when m >= 0, the inertia about the centre of
mass is positive semidefinite, and its principal moments obey the triangle inequality
(Wensing, Kim, Slotine, "Linear matrix inequalities for physically consistent inertial
parameter identification", RA-L 2018).
"""

from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from foundation.arrays import Array
from urdf.errors import InertiaError, InputError, finite_array, read_only


def principal_moments(parameters: Array) -> Array:
    """Return the principal moments about the centre of mass, ascending [kg m^2].

    The ten parameters have the shape (10,).
    """
    body = pin.Inertia.FromDynamicParameters(parameters)
    return np.asarray(np.linalg.eigvalsh(body.inertia), dtype=np.float64)


def impossible_moment(parameters: Array) -> float:
    """Return that part of a moment which no rigid body can have [kg m^2].

    With the principal moments J_1 <= J_2 <= J_3 it is ``max(-J_1, J_3 - J_1 - J_2)``; 0
    for what a body can have, up to the rounding of a table of a few digits; infinite
    without a positive mass, and for absurd numbers. The ten parameters have the shape
    (10,).
    """
    # In kg, kg m, kg m^2: beyond any link, and no product of them overflows.
    max_parameter = 1e9
    min_mass_kg = 1e-12  # less leaves no digits for a centre of mass
    is_sane = np.all(np.abs(parameters) <= max_parameter)
    if not is_sane or parameters[0] < min_mass_kg:
        return np.inf
    least, middle, largest = principal_moments(parameters).tolist()
    moment = max(-least, largest - least - middle)
    # Lost in doubles when the inertia about the origin is moved to the centre.
    cancellation = 1e-12 * float(np.sum(np.abs(parameters[[4, 6, 9]])))
    # Below 1e-12, a milligram at a millimetre, it is the rounding of a computation.
    rounding = max(1e-12, 1e-6 * abs(largest) + cancellation)
    return moment if moment > rounding else 0.0


def require_physical(parameters: Array, owner: str) -> None:
    """Raise `InertiaError` for parameters that no rigid body can have.

    The triangle inequality may be missed by the rounding of a written table. Ten zeros
    are no body, and may be.

    Args:
        parameters: The ten parameters of a body, shape (10,).
        owner: Name of the body in the message.
    """
    if np.any(parameters) and impossible_moment(parameters) > 0.0:
        shown = ", ".join(f"{value:.6g}" for value in parameters)
        raise InertiaError(
            f"{owner}: no rigid body of positive mass has the parameters (mass, first "
            f"moments, inertia) {shown}"
        )


def rigid_motion(placement: Any, name: str) -> pin.SE3:
    """Return a placement as ``pin.SE3``.

    Args:
        placement: ``pin.SE3``, a homogeneous matrix, shape (4, 4), or a translation
            alone, shape (3,), m.
        name: Name in the message.

    Raises:
        InputError: Anything else.
    """
    if isinstance(placement, pin.SE3):
        placement = placement.homogeneous
    if np.shape(placement) == (3,):
        return pin.SE3(np.eye(3), finite_array(placement, (3,), name).copy())
    matrix = finite_array(placement, (4, 4), name)
    rotation = matrix[:3, :3]
    is_rotation = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    is_right_handed = np.linalg.det(rotation) > 0.0
    if not (is_rotation and is_right_handed and np.all(matrix[3] == [0, 0, 0, 1])):
        raise InputError(f"{name} is not a rigid motion: {matrix.tolist()}")
    return pin.SE3(rotation.copy(), matrix[:3, 3].copy())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Payload:
    """A rigid body fixed to a frame (as a robot's load: its flange frame).

    Two payloads in the same frame compose with ``+``. Arrays are stored as read-only
    copies.

    Attributes:
        mass_kg: Zero only for no body at all.
        com_m: Centre of mass in the frame, shape (3,).
        inertia_kg_m2: About the centre of mass in the frame's axes, shape (3, 3).

    Raises:
        InputError: Wrong shape, not finite, or an inertia that is not symmetric.
        InertiaError: Numbers no rigid body can have.
    """

    mass_kg: float
    com_m: Array
    inertia_kg_m2: Array

    def __post_init__(self) -> None:
        mass = float(finite_array(self.mass_kg, (), "payload mass_kg"))
        inertia = finite_array(self.inertia_kg_m2, (3, 3), "payload inertia_kg_m2")
        if not np.allclose(inertia, inertia.T, rtol=1e-9, atol=1e-12):
            raise InputError(
                f"payload inertia_kg_m2 is not symmetric: {inertia.tolist()}"
            )
        object.__setattr__(self, "mass_kg", mass)
        object.__setattr__(
            self, "com_m", finite_array(self.com_m, (3,), "payload com_m")
        )
        object.__setattr__(
            self, "inertia_kg_m2", read_only(0.5 * (inertia + inertia.T))
        )
        require_physical(self.parameters, "payload")

    @classmethod
    def from_parameters(cls, parameters: ArrayLike) -> Self:
        """Build a payload from its ten parameters, shape (10,)."""
        phi = finite_array(parameters, (10,), "payload parameters")
        require_physical(phi, "payload")
        if not np.any(phi):
            return cls(mass_kg=0.0, com_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
        body = pin.Inertia.FromDynamicParameters(phi)
        return cls(mass_kg=body.mass, com_m=body.lever, inertia_kg_m2=body.inertia)

    @property
    def parameters(self) -> Array:
        """The ten parameters, shape (10,)."""
        return self.spatial_inertia.toDynamicParameters()

    @property
    def spatial_inertia(self) -> pin.Inertia:
        """The payload as a Pinocchio inertia in the same frame."""
        body = pin.Inertia(self.mass_kg, self.com_m.copy(), np.zeros((3, 3)))
        # Set afterwards, for the constructor refuses a moment of -1e-20 that rounding
        # may leave.
        body.inertia = self.inertia_kg_m2.copy()
        return body

    def moved(self, placement: pin.SE3 | ArrayLike) -> "Payload":
        """Describe the same body in another frame, in which this one is placed.

        ``pin.SE3``, a homogeneous matrix, shape (4, 4), or a translation alone, shape
        (3,), m; `InputError` for anything else.
        """
        body = rigid_motion(placement, "placement").act(self.spatial_inertia)
        return Payload.from_parameters(body.toDynamicParameters())

    def __add__(self, other: "Payload") -> "Payload":
        if not isinstance(other, Payload):
            return NotImplemented
        return Payload.from_parameters(self.parameters + other.parameters)


_SENSOR_MASS_KG = 0.236
_MAY_BE_ZERO = (
    "sensor_mass_kg",
    "sensor_height_m",
    "needle_mass_kg",
    "shaft_density_kg_m3",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class NeedleTool:
    """F/T sensor, hub and needle in a row along the flange's z axis, pointing outward.

    Without a sensor give ``sensor_height_m=0``: the hub then sits on the flange, and
    the default ``sensor_mass_kg`` counts as zero. The defaults are the tool of Ferro et
    al., which weighs 236 g up to the sensor's measuring plane and 68 g beyond it, and
    its needle reaches 153 mm from there. Its inertias follow from shapes:

    - Sensor: a Mini45 fills 45 mm by 15.7 mm with 92 g; at that density 236 g of sensor
      and adapters of the same diameter are 40 mm high. A homogeneous cylinder.
    - Shaft: a solid steel cylinder (7850 kg/m^3) of 1.27 mm (18 gauge) from the hub to
      the tip weighs 1.2 g. A 68 g needle of 153 mm would be 8.5 mm thick, so nearly all
      of the 68 g is what holds it:
    - Hub: the rest of ``needle_mass_kg``, a homogeneous cylinder at the measuring
      plane. 67 g of aluminium 30 mm across are 35 mm high.

    Attributes:
        sensor_mass_kg: Mass on the flange's side of the measuring plane.
        sensor_height_m: Distance from the flange face to the measuring plane.
        sensor_diameter_m: Diameter of that part.
        needle_mass_kg: Mass beyond the measuring plane, hub and shaft.
        needle_length_m: Distance from the measuring plane to the tip.
        needle_diameter_m: Outer diameter of the shaft.
        shaft_density_kg_m3: Density of the shaft; lower it for a hollow needle.
        hub_length_m: Length of the hub, less than the needle's.
        hub_diameter_m: Diameter of the hub.

    Raises:
        InputError: A number that is not finite, not positive (masses, density and
            sensor height may be zero), or a shaft heavier or a hub longer than the
            needle.
    """

    sensor_mass_kg: float = _SENSOR_MASS_KG
    sensor_height_m: float = 0.040
    sensor_diameter_m: float = 0.045
    needle_mass_kg: float = 0.068
    needle_length_m: float = 0.153
    needle_diameter_m: float = 0.00127
    shaft_density_kg_m3: float = 7850.0
    hub_length_m: float = 0.035
    hub_diameter_m: float = 0.030

    def __post_init__(self) -> None:
        max_number = 1e6
        for item in fields(self):
            value = float(
                finite_array(getattr(self, item.name), (), f"NeedleTool {item.name}")
            )
            if not 0.0 <= value <= max_number or (
                value == 0.0 and item.name not in _MAY_BE_ZERO
            ):
                raise InputError(
                    f"NeedleTool {item.name} is {value:g}, expected a positive number "
                    "in SI units"
                )
        if not self.has_sensor and self.sensor_mass_kg == _SENSOR_MASS_KG:
            object.__setattr__(self, "sensor_mass_kg", 0.0)
        if self.hub_length_m >= self.needle_length_m:
            raise InputError(
                f"NeedleTool hub_length_m {self.hub_length_m:g} must be shorter than "
                f"needle_length_m {self.needle_length_m:g}, measured from the sensor "
                "to the tip"
            )
        if self.shaft_mass_kg > self.needle_mass_kg:
            raise InputError(
                f"NeedleTool shaft of {self.needle_diameter_m:g} m across weighs "
                f"{self.shaft_mass_kg:.4g} kg, more than needle_mass_kg "
                f"{self.needle_mass_kg:g}; give a thinner shaft or a lower "
                "shaft_density_kg_m3"
            )

    @property
    def has_sensor(self) -> bool:
        """Whether there is a force/torque sensor between flange and needle."""
        return self.sensor_height_m > 0.0

    @property
    def shaft_mass_kg(self) -> float:
        """Mass of the bare shaft between hub and tip, kg."""
        length = self.needle_length_m - self.hub_length_m
        return (
            self.shaft_density_kg_m3 * np.pi / 4.0 * self.needle_diameter_m**2 * length
        )

    @property
    def sensor(self) -> Payload:
        """The part on the flange's side of the measuring plane, in the flange frame."""
        return _cylinder(
            self.sensor_mass_kg, 0.0, self.sensor_height_m, self.sensor_diameter_m
        )

    @property
    def beyond_sensor(self) -> Payload:
        """Hub and shaft, whose weight and inertia the sensor reads.

        In the sensor frame: the origin in the measuring plane, axes as the flange's.
        """
        hub_mass = self.needle_mass_kg - self.shaft_mass_kg
        shaft = _cylinder(
            self.shaft_mass_kg,
            self.hub_length_m,
            self.needle_length_m,
            self.needle_diameter_m,
        )
        return _cylinder(hub_mass, 0.0, self.hub_length_m, self.hub_diameter_m) + shaft

    @property
    def payload(self) -> Payload:
        """The whole tool in the flange frame."""
        return self.sensor + self.beyond_sensor.moved([0.0, 0.0, self.sensor_height_m])

    @property
    def tip_in_flange_m(self) -> Array:
        """Needle tip in the flange frame, shape (3,), m."""
        return read_only([0.0, 0.0, self.sensor_height_m + self.needle_length_m])


def _cylinder(
    mass_kg: float, start_m: float, end_m: float, diameter_m: float
) -> Payload:
    """Return a homogeneous cylinder on the z axis between two heights.

    I_xx = I_yy = m (3 r^2 + l^2) / 12,  I_zz = m r^2 / 2.
    """
    length = end_m - start_m
    radius = 0.5 * diameter_m
    across = mass_kg * (3.0 * radius**2 + length**2) / 12.0
    return Payload(
        mass_kg=mass_kg,
        com_m=np.array([0.0, 0.0, start_m + 0.5 * length]),
        inertia_kg_m2=np.diag([across, across, 0.5 * mass_kg * radius**2]),
    )
